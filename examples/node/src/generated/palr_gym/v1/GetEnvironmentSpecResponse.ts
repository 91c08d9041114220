// Original file: ../../proto/palr_gym/v1/environment_service.proto

import type { EnvironmentSpec as _palr_gym_v1_EnvironmentSpec, EnvironmentSpec__Output as _palr_gym_v1_EnvironmentSpec__Output } from '../../palr_gym/v1/EnvironmentSpec.js';

export interface GetEnvironmentSpecResponse {
  'spec'?: (_palr_gym_v1_EnvironmentSpec | null);
}

export interface GetEnvironmentSpecResponse__Output {
  'spec': (_palr_gym_v1_EnvironmentSpec__Output | null);
}
