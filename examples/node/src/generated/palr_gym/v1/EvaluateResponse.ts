// Original file: ../../proto/palr_gym/v1/evaluation_service.proto

import type { EpisodeResult as _palr_gym_v1_EpisodeResult, EpisodeResult__Output as _palr_gym_v1_EpisodeResult__Output } from '../../palr_gym/v1/EpisodeResult.js';
import type { EvaluationSummary as _palr_gym_v1_EvaluationSummary, EvaluationSummary__Output as _palr_gym_v1_EvaluationSummary__Output } from '../../palr_gym/v1/EvaluationSummary.js';

export interface EvaluateResponse {
  'episode'?: (_palr_gym_v1_EpisodeResult | null);
  'summary'?: (_palr_gym_v1_EvaluationSummary | null);
  'response'?: "episode"|"summary";
}

export interface EvaluateResponse__Output {
  'episode'?: (_palr_gym_v1_EpisodeResult__Output | null);
  'summary'?: (_palr_gym_v1_EvaluationSummary__Output | null);
  'response'?: "episode"|"summary";
}
