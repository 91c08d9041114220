// Original file: ../../proto/palr_gym/v1/tensor.proto

import type { DataType as _palr_gym_v1_DataType, DataType__Output as _palr_gym_v1_DataType__Output } from '../../palr_gym/v1/DataType.js';
import type { Long } from '@grpc/proto-loader';

export interface Tensor {
  'dtype'?: (_palr_gym_v1_DataType);
  'shape'?: (number | string | Long)[];
  'data'?: (Buffer | Uint8Array | string);
}

export interface Tensor__Output {
  'dtype': (_palr_gym_v1_DataType__Output);
  'shape': (string)[];
  'data': (Buffer);
}
