// Original file: ../../proto/palr_gym/v1/evaluation_service.proto

import type { Long } from '@grpc/proto-loader';

export interface EvaluationSummary {
  'episodes'?: (number);
  'returnMean'?: (number | string);
  'returnStandardError'?: (number | string);
  'scoreMean'?: (number | string);
  'scoreStandardError'?: (number | string);
  'scoreInterquartileMean'?: (number | string);
  'scoreInterquartileMeanLow'?: (number | string);
  'scoreInterquartileMeanHigh'?: (number | string);
  'lengthMean'?: (number | string);
  'steps'?: (number | string | Long);
  'wallTimeS'?: (number | string);
  'numEnvs'?: (number);
}

export interface EvaluationSummary__Output {
  'episodes': (number);
  'returnMean': (number);
  'returnStandardError': (number);
  'scoreMean': (number);
  'scoreStandardError': (number);
  'scoreInterquartileMean': (number);
  'scoreInterquartileMeanLow': (number);
  'scoreInterquartileMeanHigh': (number);
  'lengthMean': (number);
  'steps': (string);
  'wallTimeS': (number);
  'numEnvs': (number);
}
