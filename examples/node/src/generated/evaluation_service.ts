import type * as grpc from '@grpc/grpc-js';
import type { EnumTypeDefinition, MessageTypeDefinition } from '@grpc/proto-loader';

import type { EpisodeResult as _palr_gym_v1_EpisodeResult, EpisodeResult__Output as _palr_gym_v1_EpisodeResult__Output } from './palr_gym/v1/EpisodeResult.js';
import type { EvaluateRequest as _palr_gym_v1_EvaluateRequest, EvaluateRequest__Output as _palr_gym_v1_EvaluateRequest__Output } from './palr_gym/v1/EvaluateRequest.js';
import type { EvaluateResponse as _palr_gym_v1_EvaluateResponse, EvaluateResponse__Output as _palr_gym_v1_EvaluateResponse__Output } from './palr_gym/v1/EvaluateResponse.js';
import type { EvaluationServiceClient as _palr_gym_v1_EvaluationServiceClient, EvaluationServiceDefinition as _palr_gym_v1_EvaluationServiceDefinition } from './palr_gym/v1/EvaluationService.js';
import type { EvaluationSummary as _palr_gym_v1_EvaluationSummary, EvaluationSummary__Output as _palr_gym_v1_EvaluationSummary__Output } from './palr_gym/v1/EvaluationSummary.js';
import type { ExpertPolicy as _palr_gym_v1_ExpertPolicy, ExpertPolicy__Output as _palr_gym_v1_ExpertPolicy__Output } from './palr_gym/v1/ExpertPolicy.js';
import type { Policy as _palr_gym_v1_Policy, Policy__Output as _palr_gym_v1_Policy__Output } from './palr_gym/v1/Policy.js';
import type { RandomPolicy as _palr_gym_v1_RandomPolicy, RandomPolicy__Output as _palr_gym_v1_RandomPolicy__Output } from './palr_gym/v1/RandomPolicy.js';

type SubtypeConstructor<Constructor extends new (...args: any) => any, Subtype> = {
  new(...args: ConstructorParameters<Constructor>): Subtype;
};

export interface ProtoGrpcType {
  palr_gym: {
    v1: {
      ActionMode: EnumTypeDefinition
      EpisodeResult: MessageTypeDefinition<_palr_gym_v1_EpisodeResult, _palr_gym_v1_EpisodeResult__Output>
      EvaluateRequest: MessageTypeDefinition<_palr_gym_v1_EvaluateRequest, _palr_gym_v1_EvaluateRequest__Output>
      EvaluateResponse: MessageTypeDefinition<_palr_gym_v1_EvaluateResponse, _palr_gym_v1_EvaluateResponse__Output>
      EvaluationService: SubtypeConstructor<typeof grpc.Client, _palr_gym_v1_EvaluationServiceClient> & { service: _palr_gym_v1_EvaluationServiceDefinition }
      EvaluationSummary: MessageTypeDefinition<_palr_gym_v1_EvaluationSummary, _palr_gym_v1_EvaluationSummary__Output>
      ExpertPolicy: MessageTypeDefinition<_palr_gym_v1_ExpertPolicy, _palr_gym_v1_ExpertPolicy__Output>
      Policy: MessageTypeDefinition<_palr_gym_v1_Policy, _palr_gym_v1_Policy__Output>
      RandomPolicy: MessageTypeDefinition<_palr_gym_v1_RandomPolicy, _palr_gym_v1_RandomPolicy__Output>
    }
  }
}

