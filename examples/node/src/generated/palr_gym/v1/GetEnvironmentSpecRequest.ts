// Original file: ../../proto/palr_gym/v1/environment_service.proto


export interface GetEnvironmentSpecRequest {
  'envId'?: (string);
}

export interface GetEnvironmentSpecRequest__Output {
  'envId': (string);
}
