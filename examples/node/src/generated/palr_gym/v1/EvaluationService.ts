// Original file: ../../proto/palr_gym/v1/evaluation_service.proto

import type * as grpc from '@grpc/grpc-js'
import type { MethodDefinition } from '@grpc/proto-loader'
import type { EvaluateRequest as _palr_gym_v1_EvaluateRequest, EvaluateRequest__Output as _palr_gym_v1_EvaluateRequest__Output } from '../../palr_gym/v1/EvaluateRequest.js';
import type { EvaluateResponse as _palr_gym_v1_EvaluateResponse, EvaluateResponse__Output as _palr_gym_v1_EvaluateResponse__Output } from '../../palr_gym/v1/EvaluateResponse.js';

export interface EvaluationServiceClient extends grpc.Client {
  Evaluate(argument: _palr_gym_v1_EvaluateRequest, metadata: grpc.Metadata, options?: grpc.CallOptions): grpc.ClientReadableStream<_palr_gym_v1_EvaluateResponse__Output>;
  Evaluate(argument: _palr_gym_v1_EvaluateRequest, options?: grpc.CallOptions): grpc.ClientReadableStream<_palr_gym_v1_EvaluateResponse__Output>;
  evaluate(argument: _palr_gym_v1_EvaluateRequest, metadata: grpc.Metadata, options?: grpc.CallOptions): grpc.ClientReadableStream<_palr_gym_v1_EvaluateResponse__Output>;
  evaluate(argument: _palr_gym_v1_EvaluateRequest, options?: grpc.CallOptions): grpc.ClientReadableStream<_palr_gym_v1_EvaluateResponse__Output>;
  
}

export interface EvaluationServiceHandlers extends grpc.UntypedServiceImplementation {
  Evaluate: grpc.handleServerStreamingCall<_palr_gym_v1_EvaluateRequest__Output, _palr_gym_v1_EvaluateResponse>;
  
}

export interface EvaluationServiceDefinition extends grpc.ServiceDefinition {
  Evaluate: MethodDefinition<_palr_gym_v1_EvaluateRequest, _palr_gym_v1_EvaluateResponse, _palr_gym_v1_EvaluateRequest__Output, _palr_gym_v1_EvaluateResponse__Output>
}
