// Original file: ../../proto/palr_gym/v1/environment_service.proto

import type { Tensor as _palr_gym_v1_Tensor, Tensor__Output as _palr_gym_v1_Tensor__Output } from '../../palr_gym/v1/Tensor.js';

export interface ResetResponse {
  'observations'?: (_palr_gym_v1_Tensor | null);
  'info'?: (_palr_gym_v1_Tensor | null);
}

export interface ResetResponse__Output {
  'observations': (_palr_gym_v1_Tensor__Output | null);
  'info': (_palr_gym_v1_Tensor__Output | null);
}
