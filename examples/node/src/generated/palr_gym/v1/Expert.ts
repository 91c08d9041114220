// Original file: ../../proto/palr_gym/v1/environment.proto


export interface Expert {
  'sha256'?: (string);
  'cardReturn'?: (number | string);
  'modelCard'?: (string);
}

export interface Expert__Output {
  'sha256': (string);
  'cardReturn': (number);
  'modelCard': (string);
}
