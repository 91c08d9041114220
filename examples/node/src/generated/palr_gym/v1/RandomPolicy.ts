// Original file: ../../proto/palr_gym/v1/policy.proto


export interface RandomPolicy {
}

export interface RandomPolicy__Output {
}
