// Original file: ../../proto/palr_gym/v1/tensor.proto
export const DataType = {
    DATA_TYPE_UNSPECIFIED: 'DATA_TYPE_UNSPECIFIED',
    DATA_TYPE_FLOAT32: 'DATA_TYPE_FLOAT32',
    DATA_TYPE_FLOAT64: 'DATA_TYPE_FLOAT64',
    DATA_TYPE_BOOL: 'DATA_TYPE_BOOL',
};
