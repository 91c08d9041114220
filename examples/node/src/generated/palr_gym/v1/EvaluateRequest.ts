// Original file: ../../proto/palr_gym/v1/evaluation_service.proto

import type { Policy as _palr_gym_v1_Policy, Policy__Output as _palr_gym_v1_Policy__Output } from '../../palr_gym/v1/Policy.js';
import type { ActionMode as _palr_gym_v1_ActionMode, ActionMode__Output as _palr_gym_v1_ActionMode__Output } from '../../palr_gym/v1/ActionMode.js';
import type { Long } from '@grpc/proto-loader';

export interface EvaluateRequest {
  'envId'?: (string);
  'policy'?: (_palr_gym_v1_Policy | null);
  'episodes'?: (number);
  'seed'?: (number | string | Long);
  'actionMode'?: (_palr_gym_v1_ActionMode);
  'numEnvs'?: (number);
  '_episodes'?: "episodes";
  '_numEnvs'?: "numEnvs";
}

export interface EvaluateRequest__Output {
  'envId': (string);
  'policy': (_palr_gym_v1_Policy__Output | null);
  'episodes'?: (number);
  'seed': (string);
  'actionMode': (_palr_gym_v1_ActionMode__Output);
  'numEnvs'?: (number);
  '_episodes'?: "episodes";
  '_numEnvs'?: "numEnvs";
}
