// Original file: ../../proto/palr_gym/v1/environment.proto

import type { Mask as _palr_gym_v1_Mask, Mask__Output as _palr_gym_v1_Mask__Output } from '../../palr_gym/v1/Mask.js';
import type { BoxSpace as _palr_gym_v1_BoxSpace, BoxSpace__Output as _palr_gym_v1_BoxSpace__Output } from '../../palr_gym/v1/BoxSpace.js';
import type { ReferenceReturns as _palr_gym_v1_ReferenceReturns, ReferenceReturns__Output as _palr_gym_v1_ReferenceReturns__Output } from '../../palr_gym/v1/ReferenceReturns.js';
import type { Fidelity as _palr_gym_v1_Fidelity, Fidelity__Output as _palr_gym_v1_Fidelity__Output } from '../../palr_gym/v1/Fidelity.js';

export interface EnvironmentSpec {
  'envId'?: (string);
  'task'?: (string);
  'mask'?: (_palr_gym_v1_Mask);
  'frameStack'?: (number);
  'observationSpace'?: (_palr_gym_v1_BoxSpace | null);
  'actionSpace'?: (_palr_gym_v1_BoxSpace | null);
  'maxEpisodeSteps'?: (number);
  'frameSkip'?: (number);
  'physicsTimestepS'?: (number | string);
  'controlTimestepS'?: (number | string);
  'infoNames'?: (string)[];
  'referenceReturns'?: (_palr_gym_v1_ReferenceReturns | null);
  'hasExpert'?: (boolean);
  'maskIndices'?: (number)[];
  'fidelity'?: (_palr_gym_v1_Fidelity);
  'equals'?: (string);
  'resetInfoNames'?: (string)[];
}

export interface EnvironmentSpec__Output {
  'envId': (string);
  'task': (string);
  'mask': (_palr_gym_v1_Mask__Output);
  'frameStack': (number);
  'observationSpace': (_palr_gym_v1_BoxSpace__Output | null);
  'actionSpace': (_palr_gym_v1_BoxSpace__Output | null);
  'maxEpisodeSteps': (number);
  'frameSkip': (number);
  'physicsTimestepS': (number);
  'controlTimestepS': (number);
  'infoNames': (string)[];
  'referenceReturns': (_palr_gym_v1_ReferenceReturns__Output | null);
  'hasExpert': (boolean);
  'maskIndices': (number)[];
  'fidelity': (_palr_gym_v1_Fidelity__Output);
  'equals': (string);
  'resetInfoNames': (string)[];
}
