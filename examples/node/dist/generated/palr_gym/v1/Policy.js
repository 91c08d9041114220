// Original file: ../../proto/palr_gym/v1/policy.proto
export {};
