import type * as grpc from '@grpc/grpc-js';
import type { EnumTypeDefinition, MessageTypeDefinition } from '@grpc/proto-loader';

import type { Any as _google_protobuf_Any, Any__Output as _google_protobuf_Any__Output } from './google/protobuf/Any.js';
import type { Status as _google_rpc_Status, Status__Output as _google_rpc_Status__Output } from './google/rpc/Status.js';
import type { BoxSpace as _palr_gym_v1_BoxSpace, BoxSpace__Output as _palr_gym_v1_BoxSpace__Output } from './palr_gym/v1/BoxSpace.js';
import type { CloseSessionRequest as _palr_gym_v1_CloseSessionRequest, CloseSessionRequest__Output as _palr_gym_v1_CloseSessionRequest__Output } from './palr_gym/v1/CloseSessionRequest.js';
import type { CloseSessionResponse as _palr_gym_v1_CloseSessionResponse, CloseSessionResponse__Output as _palr_gym_v1_CloseSessionResponse__Output } from './palr_gym/v1/CloseSessionResponse.js';
import type { DivergedEpisode as _palr_gym_v1_DivergedEpisode, DivergedEpisode__Output as _palr_gym_v1_DivergedEpisode__Output } from './palr_gym/v1/DivergedEpisode.js';
import type { EnvironmentServiceClient as _palr_gym_v1_EnvironmentServiceClient, EnvironmentServiceDefinition as _palr_gym_v1_EnvironmentServiceDefinition } from './palr_gym/v1/EnvironmentService.js';
import type { EnvironmentSpec as _palr_gym_v1_EnvironmentSpec, EnvironmentSpec__Output as _palr_gym_v1_EnvironmentSpec__Output } from './palr_gym/v1/EnvironmentSpec.js';
import type { Expert as _palr_gym_v1_Expert, Expert__Output as _palr_gym_v1_Expert__Output } from './palr_gym/v1/Expert.js';
import type { FidelityProfile as _palr_gym_v1_FidelityProfile, FidelityProfile__Output as _palr_gym_v1_FidelityProfile__Output } from './palr_gym/v1/FidelityProfile.js';
import type { GetEnvironmentSpecRequest as _palr_gym_v1_GetEnvironmentSpecRequest, GetEnvironmentSpecRequest__Output as _palr_gym_v1_GetEnvironmentSpecRequest__Output } from './palr_gym/v1/GetEnvironmentSpecRequest.js';
import type { GetEnvironmentSpecResponse as _palr_gym_v1_GetEnvironmentSpecResponse, GetEnvironmentSpecResponse__Output as _palr_gym_v1_GetEnvironmentSpecResponse__Output } from './palr_gym/v1/GetEnvironmentSpecResponse.js';
import type { ListTasksRequest as _palr_gym_v1_ListTasksRequest, ListTasksRequest__Output as _palr_gym_v1_ListTasksRequest__Output } from './palr_gym/v1/ListTasksRequest.js';
import type { ListTasksResponse as _palr_gym_v1_ListTasksResponse, ListTasksResponse__Output as _palr_gym_v1_ListTasksResponse__Output } from './palr_gym/v1/ListTasksResponse.js';
import type { OpenSessionRequest as _palr_gym_v1_OpenSessionRequest, OpenSessionRequest__Output as _palr_gym_v1_OpenSessionRequest__Output } from './palr_gym/v1/OpenSessionRequest.js';
import type { OpenSessionResponse as _palr_gym_v1_OpenSessionResponse, OpenSessionResponse__Output as _palr_gym_v1_OpenSessionResponse__Output } from './palr_gym/v1/OpenSessionResponse.js';
import type { ReferenceReturns as _palr_gym_v1_ReferenceReturns, ReferenceReturns__Output as _palr_gym_v1_ReferenceReturns__Output } from './palr_gym/v1/ReferenceReturns.js';
import type { ResetRequest as _palr_gym_v1_ResetRequest, ResetRequest__Output as _palr_gym_v1_ResetRequest__Output } from './palr_gym/v1/ResetRequest.js';
import type { ResetResponse as _palr_gym_v1_ResetResponse, ResetResponse__Output as _palr_gym_v1_ResetResponse__Output } from './palr_gym/v1/ResetResponse.js';
import type { StepRequest as _palr_gym_v1_StepRequest, StepRequest__Output as _palr_gym_v1_StepRequest__Output } from './palr_gym/v1/StepRequest.js';
import type { StepResponse as _palr_gym_v1_StepResponse, StepResponse__Output as _palr_gym_v1_StepResponse__Output } from './palr_gym/v1/StepResponse.js';
import type { StepStreamRequest as _palr_gym_v1_StepStreamRequest, StepStreamRequest__Output as _palr_gym_v1_StepStreamRequest__Output } from './palr_gym/v1/StepStreamRequest.js';
import type { StepStreamResponse as _palr_gym_v1_StepStreamResponse, StepStreamResponse__Output as _palr_gym_v1_StepStreamResponse__Output } from './palr_gym/v1/StepStreamResponse.js';
import type { Task as _palr_gym_v1_Task, Task__Output as _palr_gym_v1_Task__Output } from './palr_gym/v1/Task.js';
import type { TaskMask as _palr_gym_v1_TaskMask, TaskMask__Output as _palr_gym_v1_TaskMask__Output } from './palr_gym/v1/TaskMask.js';
import type { Tensor as _palr_gym_v1_Tensor, Tensor__Output as _palr_gym_v1_Tensor__Output } from './palr_gym/v1/Tensor.js';

type SubtypeConstructor<Constructor extends new (...args: any) => any, Subtype> = {
  new(...args: ConstructorParameters<Constructor>): Subtype;
};

export interface ProtoGrpcType {
  google: {
    protobuf: {
      Any: MessageTypeDefinition<_google_protobuf_Any, _google_protobuf_Any__Output>
    }
    rpc: {
      Status: MessageTypeDefinition<_google_rpc_Status, _google_rpc_Status__Output>
    }
  }
  palr_gym: {
    v1: {
      AutoresetMode: EnumTypeDefinition
      BoxSpace: MessageTypeDefinition<_palr_gym_v1_BoxSpace, _palr_gym_v1_BoxSpace__Output>
      CloseSessionRequest: MessageTypeDefinition<_palr_gym_v1_CloseSessionRequest, _palr_gym_v1_CloseSessionRequest__Output>
      CloseSessionResponse: MessageTypeDefinition<_palr_gym_v1_CloseSessionResponse, _palr_gym_v1_CloseSessionResponse__Output>
      DataType: EnumTypeDefinition
      DivergedEpisode: MessageTypeDefinition<_palr_gym_v1_DivergedEpisode, _palr_gym_v1_DivergedEpisode__Output>
      Divergence: EnumTypeDefinition
      EnvironmentService: SubtypeConstructor<typeof grpc.Client, _palr_gym_v1_EnvironmentServiceClient> & { service: _palr_gym_v1_EnvironmentServiceDefinition }
      EnvironmentSpec: MessageTypeDefinition<_palr_gym_v1_EnvironmentSpec, _palr_gym_v1_EnvironmentSpec__Output>
      Expert: MessageTypeDefinition<_palr_gym_v1_Expert, _palr_gym_v1_Expert__Output>
      Fidelity: EnumTypeDefinition
      FidelityProfile: MessageTypeDefinition<_palr_gym_v1_FidelityProfile, _palr_gym_v1_FidelityProfile__Output>
      GetEnvironmentSpecRequest: MessageTypeDefinition<_palr_gym_v1_GetEnvironmentSpecRequest, _palr_gym_v1_GetEnvironmentSpecRequest__Output>
      GetEnvironmentSpecResponse: MessageTypeDefinition<_palr_gym_v1_GetEnvironmentSpecResponse, _palr_gym_v1_GetEnvironmentSpecResponse__Output>
      ListTasksRequest: MessageTypeDefinition<_palr_gym_v1_ListTasksRequest, _palr_gym_v1_ListTasksRequest__Output>
      ListTasksResponse: MessageTypeDefinition<_palr_gym_v1_ListTasksResponse, _palr_gym_v1_ListTasksResponse__Output>
      Mask: EnumTypeDefinition
      OpenSessionRequest: MessageTypeDefinition<_palr_gym_v1_OpenSessionRequest, _palr_gym_v1_OpenSessionRequest__Output>
      OpenSessionResponse: MessageTypeDefinition<_palr_gym_v1_OpenSessionResponse, _palr_gym_v1_OpenSessionResponse__Output>
      OutOfBounds: EnumTypeDefinition
      ReferenceReturns: MessageTypeDefinition<_palr_gym_v1_ReferenceReturns, _palr_gym_v1_ReferenceReturns__Output>
      ResetRequest: MessageTypeDefinition<_palr_gym_v1_ResetRequest, _palr_gym_v1_ResetRequest__Output>
      ResetResponse: MessageTypeDefinition<_palr_gym_v1_ResetResponse, _palr_gym_v1_ResetResponse__Output>
      StepRequest: MessageTypeDefinition<_palr_gym_v1_StepRequest, _palr_gym_v1_StepRequest__Output>
      StepResponse: MessageTypeDefinition<_palr_gym_v1_StepResponse, _palr_gym_v1_StepResponse__Output>
      StepStreamRequest: MessageTypeDefinition<_palr_gym_v1_StepStreamRequest, _palr_gym_v1_StepStreamRequest__Output>
      StepStreamResponse: MessageTypeDefinition<_palr_gym_v1_StepStreamResponse, _palr_gym_v1_StepStreamResponse__Output>
      Task: MessageTypeDefinition<_palr_gym_v1_Task, _palr_gym_v1_Task__Output>
      TaskMask: MessageTypeDefinition<_palr_gym_v1_TaskMask, _palr_gym_v1_TaskMask__Output>
      Tensor: MessageTypeDefinition<_palr_gym_v1_Tensor, _palr_gym_v1_Tensor__Output>
    }
  }
}

