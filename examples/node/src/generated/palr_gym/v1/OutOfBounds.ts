// Original file: ../../proto/palr_gym/v1/environment.proto

export const OutOfBounds = {
  OUT_OF_BOUNDS_UNSPECIFIED: 'OUT_OF_BOUNDS_UNSPECIFIED',
  OUT_OF_BOUNDS_REJECT: 'OUT_OF_BOUNDS_REJECT',
  OUT_OF_BOUNDS_CLIP: 'OUT_OF_BOUNDS_CLIP',
  OUT_OF_BOUNDS_RAW: 'OUT_OF_BOUNDS_RAW',
} as const;

export type OutOfBounds =
  | 'OUT_OF_BOUNDS_UNSPECIFIED'
  | 0
  | 'OUT_OF_BOUNDS_REJECT'
  | 1
  | 'OUT_OF_BOUNDS_CLIP'
  | 2
  | 'OUT_OF_BOUNDS_RAW'
  | 3

export type OutOfBounds__Output = typeof OutOfBounds[keyof typeof OutOfBounds]
