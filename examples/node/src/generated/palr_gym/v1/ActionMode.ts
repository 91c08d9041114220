// Original file: ../../proto/palr_gym/v1/policy.proto

export const ActionMode = {
  ACTION_MODE_UNSPECIFIED: 'ACTION_MODE_UNSPECIFIED',
  ACTION_MODE_DETERMINISTIC: 'ACTION_MODE_DETERMINISTIC',
  ACTION_MODE_SAMPLED: 'ACTION_MODE_SAMPLED',
} as const;

export type ActionMode =
  | 'ACTION_MODE_UNSPECIFIED'
  | 0
  | 'ACTION_MODE_DETERMINISTIC'
  | 1
  | 'ACTION_MODE_SAMPLED'
  | 2

export type ActionMode__Output = typeof ActionMode[keyof typeof ActionMode]
