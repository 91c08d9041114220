// Original file: ../../proto/palr_gym/v1/environment_service.proto
export {};
