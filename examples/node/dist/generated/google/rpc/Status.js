// Original file: ../../proto/google/rpc/status.proto
export {};
