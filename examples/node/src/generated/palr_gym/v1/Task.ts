// Original file: ../../proto/palr_gym/v1/environment.proto

import type { TaskMask as _palr_gym_v1_TaskMask, TaskMask__Output as _palr_gym_v1_TaskMask__Output } from '../../palr_gym/v1/TaskMask.js';
import type { ReferenceReturns as _palr_gym_v1_ReferenceReturns, ReferenceReturns__Output as _palr_gym_v1_ReferenceReturns__Output } from '../../palr_gym/v1/ReferenceReturns.js';
import type { Expert as _palr_gym_v1_Expert, Expert__Output as _palr_gym_v1_Expert__Output } from '../../palr_gym/v1/Expert.js';
import type { FidelityProfile as _palr_gym_v1_FidelityProfile, FidelityProfile__Output as _palr_gym_v1_FidelityProfile__Output } from '../../palr_gym/v1/FidelityProfile.js';

export interface Task {
  'name'?: (string);
  'description'?: (string);
  'equals'?: (string);
  'fullObservationSize'?: (number);
  'actionSize'?: (number);
  'maxEpisodeSteps'?: (number);
  'masks'?: (_palr_gym_v1_TaskMask)[];
  'referenceReturns'?: (_palr_gym_v1_ReferenceReturns | null);
  'expert'?: (_palr_gym_v1_Expert | null);
  'fidelityProfiles'?: (_palr_gym_v1_FidelityProfile)[];
}

export interface Task__Output {
  'name': (string);
  'description': (string);
  'equals': (string);
  'fullObservationSize': (number);
  'actionSize': (number);
  'maxEpisodeSteps': (number);
  'masks': (_palr_gym_v1_TaskMask__Output)[];
  'referenceReturns': (_palr_gym_v1_ReferenceReturns__Output | null);
  'expert': (_palr_gym_v1_Expert__Output | null);
  'fidelityProfiles': (_palr_gym_v1_FidelityProfile__Output)[];
}
