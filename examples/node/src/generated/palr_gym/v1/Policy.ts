// Original file: ../../proto/palr_gym/v1/policy.proto

import type { RandomPolicy as _palr_gym_v1_RandomPolicy, RandomPolicy__Output as _palr_gym_v1_RandomPolicy__Output } from '../../palr_gym/v1/RandomPolicy.js';
import type { ExpertPolicy as _palr_gym_v1_ExpertPolicy, ExpertPolicy__Output as _palr_gym_v1_ExpertPolicy__Output } from '../../palr_gym/v1/ExpertPolicy.js';

export interface Policy {
  'random'?: (_palr_gym_v1_RandomPolicy | null);
  'expert'?: (_palr_gym_v1_ExpertPolicy | null);
  'onnx'?: (Buffer | Uint8Array | string);
  'policy'?: "random"|"expert"|"onnx";
}

export interface Policy__Output {
  'random'?: (_palr_gym_v1_RandomPolicy__Output | null);
  'expert'?: (_palr_gym_v1_ExpertPolicy__Output | null);
  'onnx'?: (Buffer);
  'policy'?: "random"|"expert"|"onnx";
}
