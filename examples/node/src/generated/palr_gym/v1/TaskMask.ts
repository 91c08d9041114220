// Original file: ../../proto/palr_gym/v1/environment.proto

import type { Mask as _palr_gym_v1_Mask, Mask__Output as _palr_gym_v1_Mask__Output } from '../../palr_gym/v1/Mask.js';

export interface TaskMask {
  'mask'?: (_palr_gym_v1_Mask);
  'indices'?: (number)[];
}

export interface TaskMask__Output {
  'mask': (_palr_gym_v1_Mask__Output);
  'indices': (number)[];
}
