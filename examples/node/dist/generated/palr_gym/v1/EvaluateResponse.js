// Original file: ../../proto/palr_gym/v1/evaluation_service.proto
export {};
