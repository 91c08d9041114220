// Original file: ../../proto/palr_gym/v1/environment_service.proto

import type { ResetRequest as _palr_gym_v1_ResetRequest, ResetRequest__Output as _palr_gym_v1_ResetRequest__Output } from '../../palr_gym/v1/ResetRequest.js';
import type { StepRequest as _palr_gym_v1_StepRequest, StepRequest__Output as _palr_gym_v1_StepRequest__Output } from '../../palr_gym/v1/StepRequest.js';

export interface StepStreamRequest {
  'reset'?: (_palr_gym_v1_ResetRequest | null);
  'step'?: (_palr_gym_v1_StepRequest | null);
  'request'?: "reset"|"step";
}

export interface StepStreamRequest__Output {
  'reset'?: (_palr_gym_v1_ResetRequest__Output | null);
  'step'?: (_palr_gym_v1_StepRequest__Output | null);
  'request'?: "reset"|"step";
}
