// Original file: ../../proto/palr_gym/v1/environment_service.proto

import type { AutoresetMode as _palr_gym_v1_AutoresetMode, AutoresetMode__Output as _palr_gym_v1_AutoresetMode__Output } from '../../palr_gym/v1/AutoresetMode.js';
import type { OutOfBounds as _palr_gym_v1_OutOfBounds, OutOfBounds__Output as _palr_gym_v1_OutOfBounds__Output } from '../../palr_gym/v1/OutOfBounds.js';
import type { DataType as _palr_gym_v1_DataType, DataType__Output as _palr_gym_v1_DataType__Output } from '../../palr_gym/v1/DataType.js';

export interface OpenSessionRequest {
  'envId'?: (string);
  'numEnvs'?: (number);
  'autoresetMode'?: (_palr_gym_v1_AutoresetMode);
  'outOfBounds'?: (_palr_gym_v1_OutOfBounds);
  'observationDtype'?: (_palr_gym_v1_DataType);
  '_numEnvs'?: "numEnvs";
}

export interface OpenSessionRequest__Output {
  'envId': (string);
  'numEnvs'?: (number);
  'autoresetMode': (_palr_gym_v1_AutoresetMode__Output);
  'outOfBounds': (_palr_gym_v1_OutOfBounds__Output);
  'observationDtype': (_palr_gym_v1_DataType__Output);
  '_numEnvs'?: "numEnvs";
}
