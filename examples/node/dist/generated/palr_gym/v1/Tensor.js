// Original file: ../../proto/palr_gym/v1/tensor.proto
export {};
