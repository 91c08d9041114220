// Original file: ../../proto/palr_gym/v1/evaluation_service.proto

import type { Long } from '@grpc/proto-loader';

export interface EpisodeResult {
  'index'?: (number);
  'seed'?: (number | string | Long);
  'episodeReturn'?: (number | string);
  'normalizedScore'?: (number | string);
  'length'?: (number);
  'terminated'?: (boolean);
  'truncated'?: (boolean);
}

export interface EpisodeResult__Output {
  'index': (number);
  'seed': (string);
  'episodeReturn': (number);
  'normalizedScore': (number);
  'length': (number);
  'terminated': (boolean);
  'truncated': (boolean);
}
