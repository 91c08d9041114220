// Original file: ../../proto/palr_gym/v1/environment_service.proto

import type { ResetResponse as _palr_gym_v1_ResetResponse, ResetResponse__Output as _palr_gym_v1_ResetResponse__Output } from '../../palr_gym/v1/ResetResponse.js';
import type { StepResponse as _palr_gym_v1_StepResponse, StepResponse__Output as _palr_gym_v1_StepResponse__Output } from '../../palr_gym/v1/StepResponse.js';
import type { Status as _google_rpc_Status, Status__Output as _google_rpc_Status__Output } from '../../google/rpc/Status.js';

export interface StepStreamResponse {
  'reset'?: (_palr_gym_v1_ResetResponse | null);
  'step'?: (_palr_gym_v1_StepResponse | null);
  'error'?: (_google_rpc_Status | null);
  'response'?: "reset"|"step"|"error";
}

export interface StepStreamResponse__Output {
  'reset'?: (_palr_gym_v1_ResetResponse__Output | null);
  'step'?: (_palr_gym_v1_StepResponse__Output | null);
  'error'?: (_google_rpc_Status__Output | null);
  'response'?: "reset"|"step"|"error";
}
