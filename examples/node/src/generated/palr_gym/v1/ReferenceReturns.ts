// Original file: ../../proto/palr_gym/v1/environment.proto


export interface ReferenceReturns {
  'random'?: (number | string);
  'expert'?: (number | string);
}

export interface ReferenceReturns__Output {
  'random': (number);
  'expert': (number);
}
