// Original file: ../../proto/palr_gym/v1/environment_service.proto

import type { Task as _palr_gym_v1_Task, Task__Output as _palr_gym_v1_Task__Output } from '../../palr_gym/v1/Task.js';

export interface ListTasksResponse {
  'tasks'?: (_palr_gym_v1_Task)[];
}

export interface ListTasksResponse__Output {
  'tasks': (_palr_gym_v1_Task__Output)[];
}
