// Original file: ../../proto/palr_gym/v1/environment.proto

export const Mask = {
  MASK_UNSPECIFIED: 'MASK_UNSPECIFIED',
  MASK_FULL: 'MASK_FULL',
  MASK_PAPER: 'MASK_PAPER',
  MASK_STRICT: 'MASK_STRICT',
} as const;

export type Mask =
  | 'MASK_UNSPECIFIED'
  | 0
  | 'MASK_FULL'
  | 1
  | 'MASK_PAPER'
  | 2
  | 'MASK_STRICT'
  | 3

export type Mask__Output = typeof Mask[keyof typeof Mask]
