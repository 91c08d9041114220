// Original file: ../../proto/palr_gym/v1/environment_service.proto

import type { Long } from '@grpc/proto-loader';

export interface ResetRequest {
  'sessionId'?: (string);
  'seeds'?: (number | string | Long)[];
  'envIndices'?: (number)[];
}

export interface ResetRequest__Output {
  'sessionId': (string);
  'seeds': (string)[];
  'envIndices': (number)[];
}
