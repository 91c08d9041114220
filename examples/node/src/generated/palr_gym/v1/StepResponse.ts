// Original file: ../../proto/palr_gym/v1/environment_service.proto

import type { Tensor as _palr_gym_v1_Tensor, Tensor__Output as _palr_gym_v1_Tensor__Output } from '../../palr_gym/v1/Tensor.js';
import type { DivergedEpisode as _palr_gym_v1_DivergedEpisode, DivergedEpisode__Output as _palr_gym_v1_DivergedEpisode__Output } from '../../palr_gym/v1/DivergedEpisode.js';

export interface StepResponse {
  'observations'?: (_palr_gym_v1_Tensor | null);
  'rewards'?: (_palr_gym_v1_Tensor | null);
  'terminated'?: (_palr_gym_v1_Tensor | null);
  'truncated'?: (_palr_gym_v1_Tensor | null);
  'info'?: (_palr_gym_v1_Tensor | null);
  'finalObservations'?: (_palr_gym_v1_Tensor | null);
  'resetInfo'?: (_palr_gym_v1_Tensor | null);
  'diverged'?: (_palr_gym_v1_DivergedEpisode)[];
}

export interface StepResponse__Output {
  'observations': (_palr_gym_v1_Tensor__Output | null);
  'rewards': (_palr_gym_v1_Tensor__Output | null);
  'terminated': (_palr_gym_v1_Tensor__Output | null);
  'truncated': (_palr_gym_v1_Tensor__Output | null);
  'info': (_palr_gym_v1_Tensor__Output | null);
  'finalObservations': (_palr_gym_v1_Tensor__Output | null);
  'resetInfo': (_palr_gym_v1_Tensor__Output | null);
  'diverged': (_palr_gym_v1_DivergedEpisode__Output)[];
}
