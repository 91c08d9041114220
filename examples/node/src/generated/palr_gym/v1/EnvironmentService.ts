// Original file: ../../proto/palr_gym/v1/environment_service.proto

import type * as grpc from '@grpc/grpc-js'
import type { MethodDefinition } from '@grpc/proto-loader'
import type { CloseSessionRequest as _palr_gym_v1_CloseSessionRequest, CloseSessionRequest__Output as _palr_gym_v1_CloseSessionRequest__Output } from '../../palr_gym/v1/CloseSessionRequest.js';
import type { CloseSessionResponse as _palr_gym_v1_CloseSessionResponse, CloseSessionResponse__Output as _palr_gym_v1_CloseSessionResponse__Output } from '../../palr_gym/v1/CloseSessionResponse.js';
import type { GetEnvironmentSpecRequest as _palr_gym_v1_GetEnvironmentSpecRequest, GetEnvironmentSpecRequest__Output as _palr_gym_v1_GetEnvironmentSpecRequest__Output } from '../../palr_gym/v1/GetEnvironmentSpecRequest.js';
import type { GetEnvironmentSpecResponse as _palr_gym_v1_GetEnvironmentSpecResponse, GetEnvironmentSpecResponse__Output as _palr_gym_v1_GetEnvironmentSpecResponse__Output } from '../../palr_gym/v1/GetEnvironmentSpecResponse.js';
import type { ListTasksRequest as _palr_gym_v1_ListTasksRequest, ListTasksRequest__Output as _palr_gym_v1_ListTasksRequest__Output } from '../../palr_gym/v1/ListTasksRequest.js';
import type { ListTasksResponse as _palr_gym_v1_ListTasksResponse, ListTasksResponse__Output as _palr_gym_v1_ListTasksResponse__Output } from '../../palr_gym/v1/ListTasksResponse.js';
import type { OpenSessionRequest as _palr_gym_v1_OpenSessionRequest, OpenSessionRequest__Output as _palr_gym_v1_OpenSessionRequest__Output } from '../../palr_gym/v1/OpenSessionRequest.js';
import type { OpenSessionResponse as _palr_gym_v1_OpenSessionResponse, OpenSessionResponse__Output as _palr_gym_v1_OpenSessionResponse__Output } from '../../palr_gym/v1/OpenSessionResponse.js';
import type { ResetRequest as _palr_gym_v1_ResetRequest, ResetRequest__Output as _palr_gym_v1_ResetRequest__Output } from '../../palr_gym/v1/ResetRequest.js';
import type { ResetResponse as _palr_gym_v1_ResetResponse, ResetResponse__Output as _palr_gym_v1_ResetResponse__Output } from '../../palr_gym/v1/ResetResponse.js';
import type { StepRequest as _palr_gym_v1_StepRequest, StepRequest__Output as _palr_gym_v1_StepRequest__Output } from '../../palr_gym/v1/StepRequest.js';
import type { StepResponse as _palr_gym_v1_StepResponse, StepResponse__Output as _palr_gym_v1_StepResponse__Output } from '../../palr_gym/v1/StepResponse.js';
import type { StepStreamRequest as _palr_gym_v1_StepStreamRequest, StepStreamRequest__Output as _palr_gym_v1_StepStreamRequest__Output } from '../../palr_gym/v1/StepStreamRequest.js';
import type { StepStreamResponse as _palr_gym_v1_StepStreamResponse, StepStreamResponse__Output as _palr_gym_v1_StepStreamResponse__Output } from '../../palr_gym/v1/StepStreamResponse.js';

export interface EnvironmentServiceClient extends grpc.Client {
  CloseSession(argument: _palr_gym_v1_CloseSessionRequest, metadata: grpc.Metadata, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_CloseSessionResponse__Output>): grpc.ClientUnaryCall;
  CloseSession(argument: _palr_gym_v1_CloseSessionRequest, metadata: grpc.Metadata, callback: grpc.requestCallback<_palr_gym_v1_CloseSessionResponse__Output>): grpc.ClientUnaryCall;
  CloseSession(argument: _palr_gym_v1_CloseSessionRequest, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_CloseSessionResponse__Output>): grpc.ClientUnaryCall;
  CloseSession(argument: _palr_gym_v1_CloseSessionRequest, callback: grpc.requestCallback<_palr_gym_v1_CloseSessionResponse__Output>): grpc.ClientUnaryCall;
  closeSession(argument: _palr_gym_v1_CloseSessionRequest, metadata: grpc.Metadata, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_CloseSessionResponse__Output>): grpc.ClientUnaryCall;
  closeSession(argument: _palr_gym_v1_CloseSessionRequest, metadata: grpc.Metadata, callback: grpc.requestCallback<_palr_gym_v1_CloseSessionResponse__Output>): grpc.ClientUnaryCall;
  closeSession(argument: _palr_gym_v1_CloseSessionRequest, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_CloseSessionResponse__Output>): grpc.ClientUnaryCall;
  closeSession(argument: _palr_gym_v1_CloseSessionRequest, callback: grpc.requestCallback<_palr_gym_v1_CloseSessionResponse__Output>): grpc.ClientUnaryCall;
  
  GetEnvironmentSpec(argument: _palr_gym_v1_GetEnvironmentSpecRequest, metadata: grpc.Metadata, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_GetEnvironmentSpecResponse__Output>): grpc.ClientUnaryCall;
  GetEnvironmentSpec(argument: _palr_gym_v1_GetEnvironmentSpecRequest, metadata: grpc.Metadata, callback: grpc.requestCallback<_palr_gym_v1_GetEnvironmentSpecResponse__Output>): grpc.ClientUnaryCall;
  GetEnvironmentSpec(argument: _palr_gym_v1_GetEnvironmentSpecRequest, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_GetEnvironmentSpecResponse__Output>): grpc.ClientUnaryCall;
  GetEnvironmentSpec(argument: _palr_gym_v1_GetEnvironmentSpecRequest, callback: grpc.requestCallback<_palr_gym_v1_GetEnvironmentSpecResponse__Output>): grpc.ClientUnaryCall;
  getEnvironmentSpec(argument: _palr_gym_v1_GetEnvironmentSpecRequest, metadata: grpc.Metadata, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_GetEnvironmentSpecResponse__Output>): grpc.ClientUnaryCall;
  getEnvironmentSpec(argument: _palr_gym_v1_GetEnvironmentSpecRequest, metadata: grpc.Metadata, callback: grpc.requestCallback<_palr_gym_v1_GetEnvironmentSpecResponse__Output>): grpc.ClientUnaryCall;
  getEnvironmentSpec(argument: _palr_gym_v1_GetEnvironmentSpecRequest, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_GetEnvironmentSpecResponse__Output>): grpc.ClientUnaryCall;
  getEnvironmentSpec(argument: _palr_gym_v1_GetEnvironmentSpecRequest, callback: grpc.requestCallback<_palr_gym_v1_GetEnvironmentSpecResponse__Output>): grpc.ClientUnaryCall;
  
  ListTasks(argument: _palr_gym_v1_ListTasksRequest, metadata: grpc.Metadata, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_ListTasksResponse__Output>): grpc.ClientUnaryCall;
  ListTasks(argument: _palr_gym_v1_ListTasksRequest, metadata: grpc.Metadata, callback: grpc.requestCallback<_palr_gym_v1_ListTasksResponse__Output>): grpc.ClientUnaryCall;
  ListTasks(argument: _palr_gym_v1_ListTasksRequest, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_ListTasksResponse__Output>): grpc.ClientUnaryCall;
  ListTasks(argument: _palr_gym_v1_ListTasksRequest, callback: grpc.requestCallback<_palr_gym_v1_ListTasksResponse__Output>): grpc.ClientUnaryCall;
  listTasks(argument: _palr_gym_v1_ListTasksRequest, metadata: grpc.Metadata, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_ListTasksResponse__Output>): grpc.ClientUnaryCall;
  listTasks(argument: _palr_gym_v1_ListTasksRequest, metadata: grpc.Metadata, callback: grpc.requestCallback<_palr_gym_v1_ListTasksResponse__Output>): grpc.ClientUnaryCall;
  listTasks(argument: _palr_gym_v1_ListTasksRequest, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_ListTasksResponse__Output>): grpc.ClientUnaryCall;
  listTasks(argument: _palr_gym_v1_ListTasksRequest, callback: grpc.requestCallback<_palr_gym_v1_ListTasksResponse__Output>): grpc.ClientUnaryCall;
  
  OpenSession(argument: _palr_gym_v1_OpenSessionRequest, metadata: grpc.Metadata, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_OpenSessionResponse__Output>): grpc.ClientUnaryCall;
  OpenSession(argument: _palr_gym_v1_OpenSessionRequest, metadata: grpc.Metadata, callback: grpc.requestCallback<_palr_gym_v1_OpenSessionResponse__Output>): grpc.ClientUnaryCall;
  OpenSession(argument: _palr_gym_v1_OpenSessionRequest, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_OpenSessionResponse__Output>): grpc.ClientUnaryCall;
  OpenSession(argument: _palr_gym_v1_OpenSessionRequest, callback: grpc.requestCallback<_palr_gym_v1_OpenSessionResponse__Output>): grpc.ClientUnaryCall;
  openSession(argument: _palr_gym_v1_OpenSessionRequest, metadata: grpc.Metadata, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_OpenSessionResponse__Output>): grpc.ClientUnaryCall;
  openSession(argument: _palr_gym_v1_OpenSessionRequest, metadata: grpc.Metadata, callback: grpc.requestCallback<_palr_gym_v1_OpenSessionResponse__Output>): grpc.ClientUnaryCall;
  openSession(argument: _palr_gym_v1_OpenSessionRequest, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_OpenSessionResponse__Output>): grpc.ClientUnaryCall;
  openSession(argument: _palr_gym_v1_OpenSessionRequest, callback: grpc.requestCallback<_palr_gym_v1_OpenSessionResponse__Output>): grpc.ClientUnaryCall;
  
  Reset(argument: _palr_gym_v1_ResetRequest, metadata: grpc.Metadata, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_ResetResponse__Output>): grpc.ClientUnaryCall;
  Reset(argument: _palr_gym_v1_ResetRequest, metadata: grpc.Metadata, callback: grpc.requestCallback<_palr_gym_v1_ResetResponse__Output>): grpc.ClientUnaryCall;
  Reset(argument: _palr_gym_v1_ResetRequest, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_ResetResponse__Output>): grpc.ClientUnaryCall;
  Reset(argument: _palr_gym_v1_ResetRequest, callback: grpc.requestCallback<_palr_gym_v1_ResetResponse__Output>): grpc.ClientUnaryCall;
  reset(argument: _palr_gym_v1_ResetRequest, metadata: grpc.Metadata, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_ResetResponse__Output>): grpc.ClientUnaryCall;
  reset(argument: _palr_gym_v1_ResetRequest, metadata: grpc.Metadata, callback: grpc.requestCallback<_palr_gym_v1_ResetResponse__Output>): grpc.ClientUnaryCall;
  reset(argument: _palr_gym_v1_ResetRequest, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_ResetResponse__Output>): grpc.ClientUnaryCall;
  reset(argument: _palr_gym_v1_ResetRequest, callback: grpc.requestCallback<_palr_gym_v1_ResetResponse__Output>): grpc.ClientUnaryCall;
  
  Step(argument: _palr_gym_v1_StepRequest, metadata: grpc.Metadata, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_StepResponse__Output>): grpc.ClientUnaryCall;
  Step(argument: _palr_gym_v1_StepRequest, metadata: grpc.Metadata, callback: grpc.requestCallback<_palr_gym_v1_StepResponse__Output>): grpc.ClientUnaryCall;
  Step(argument: _palr_gym_v1_StepRequest, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_StepResponse__Output>): grpc.ClientUnaryCall;
  Step(argument: _palr_gym_v1_StepRequest, callback: grpc.requestCallback<_palr_gym_v1_StepResponse__Output>): grpc.ClientUnaryCall;
  step(argument: _palr_gym_v1_StepRequest, metadata: grpc.Metadata, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_StepResponse__Output>): grpc.ClientUnaryCall;
  step(argument: _palr_gym_v1_StepRequest, metadata: grpc.Metadata, callback: grpc.requestCallback<_palr_gym_v1_StepResponse__Output>): grpc.ClientUnaryCall;
  step(argument: _palr_gym_v1_StepRequest, options: grpc.CallOptions, callback: grpc.requestCallback<_palr_gym_v1_StepResponse__Output>): grpc.ClientUnaryCall;
  step(argument: _palr_gym_v1_StepRequest, callback: grpc.requestCallback<_palr_gym_v1_StepResponse__Output>): grpc.ClientUnaryCall;
  
  StepStream(metadata: grpc.Metadata, options?: grpc.CallOptions): grpc.ClientDuplexStream<_palr_gym_v1_StepStreamRequest, _palr_gym_v1_StepStreamResponse__Output>;
  StepStream(options?: grpc.CallOptions): grpc.ClientDuplexStream<_palr_gym_v1_StepStreamRequest, _palr_gym_v1_StepStreamResponse__Output>;
  stepStream(metadata: grpc.Metadata, options?: grpc.CallOptions): grpc.ClientDuplexStream<_palr_gym_v1_StepStreamRequest, _palr_gym_v1_StepStreamResponse__Output>;
  stepStream(options?: grpc.CallOptions): grpc.ClientDuplexStream<_palr_gym_v1_StepStreamRequest, _palr_gym_v1_StepStreamResponse__Output>;
  
}

export interface EnvironmentServiceHandlers extends grpc.UntypedServiceImplementation {
  CloseSession: grpc.handleUnaryCall<_palr_gym_v1_CloseSessionRequest__Output, _palr_gym_v1_CloseSessionResponse>;
  
  GetEnvironmentSpec: grpc.handleUnaryCall<_palr_gym_v1_GetEnvironmentSpecRequest__Output, _palr_gym_v1_GetEnvironmentSpecResponse>;
  
  ListTasks: grpc.handleUnaryCall<_palr_gym_v1_ListTasksRequest__Output, _palr_gym_v1_ListTasksResponse>;
  
  OpenSession: grpc.handleUnaryCall<_palr_gym_v1_OpenSessionRequest__Output, _palr_gym_v1_OpenSessionResponse>;
  
  Reset: grpc.handleUnaryCall<_palr_gym_v1_ResetRequest__Output, _palr_gym_v1_ResetResponse>;
  
  Step: grpc.handleUnaryCall<_palr_gym_v1_StepRequest__Output, _palr_gym_v1_StepResponse>;
  
  StepStream: grpc.handleBidiStreamingCall<_palr_gym_v1_StepStreamRequest__Output, _palr_gym_v1_StepStreamResponse>;
  
}

export interface EnvironmentServiceDefinition extends grpc.ServiceDefinition {
  CloseSession: MethodDefinition<_palr_gym_v1_CloseSessionRequest, _palr_gym_v1_CloseSessionResponse, _palr_gym_v1_CloseSessionRequest__Output, _palr_gym_v1_CloseSessionResponse__Output>
  GetEnvironmentSpec: MethodDefinition<_palr_gym_v1_GetEnvironmentSpecRequest, _palr_gym_v1_GetEnvironmentSpecResponse, _palr_gym_v1_GetEnvironmentSpecRequest__Output, _palr_gym_v1_GetEnvironmentSpecResponse__Output>
  ListTasks: MethodDefinition<_palr_gym_v1_ListTasksRequest, _palr_gym_v1_ListTasksResponse, _palr_gym_v1_ListTasksRequest__Output, _palr_gym_v1_ListTasksResponse__Output>
  OpenSession: MethodDefinition<_palr_gym_v1_OpenSessionRequest, _palr_gym_v1_OpenSessionResponse, _palr_gym_v1_OpenSessionRequest__Output, _palr_gym_v1_OpenSessionResponse__Output>
  Reset: MethodDefinition<_palr_gym_v1_ResetRequest, _palr_gym_v1_ResetResponse, _palr_gym_v1_ResetRequest__Output, _palr_gym_v1_ResetResponse__Output>
  Step: MethodDefinition<_palr_gym_v1_StepRequest, _palr_gym_v1_StepResponse, _palr_gym_v1_StepRequest__Output, _palr_gym_v1_StepResponse__Output>
  StepStream: MethodDefinition<_palr_gym_v1_StepStreamRequest, _palr_gym_v1_StepStreamResponse, _palr_gym_v1_StepStreamRequest__Output, _palr_gym_v1_StepStreamResponse__Output>
}
