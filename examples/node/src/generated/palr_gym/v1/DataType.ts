// Original file: ../../proto/palr_gym/v1/tensor.proto

export const DataType = {
  DATA_TYPE_UNSPECIFIED: 'DATA_TYPE_UNSPECIFIED',
  DATA_TYPE_FLOAT32: 'DATA_TYPE_FLOAT32',
  DATA_TYPE_FLOAT64: 'DATA_TYPE_FLOAT64',
  DATA_TYPE_BOOL: 'DATA_TYPE_BOOL',
} as const;

export type DataType =
  | 'DATA_TYPE_UNSPECIFIED'
  | 0
  | 'DATA_TYPE_FLOAT32'
  | 1
  | 'DATA_TYPE_FLOAT64'
  | 2
  | 'DATA_TYPE_BOOL'
  | 3

export type DataType__Output = typeof DataType[keyof typeof DataType]
