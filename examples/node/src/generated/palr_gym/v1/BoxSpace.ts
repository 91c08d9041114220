// Original file: ../../proto/palr_gym/v1/environment.proto

import type { DataType as _palr_gym_v1_DataType, DataType__Output as _palr_gym_v1_DataType__Output } from '../../palr_gym/v1/DataType.js';
import type { Long } from '@grpc/proto-loader';

export interface BoxSpace {
  'dtype'?: (_palr_gym_v1_DataType);
  'shape'?: (number | string | Long)[];
  'low'?: (number | string)[];
  'high'?: (number | string)[];
  'names'?: (string)[];
}

export interface BoxSpace__Output {
  'dtype': (_palr_gym_v1_DataType__Output);
  'shape': (string)[];
  'low': (number)[];
  'high': (number)[];
  'names': (string)[];
}
