// Original file: ../../proto/palr_gym/v1/environment.proto
export {};
