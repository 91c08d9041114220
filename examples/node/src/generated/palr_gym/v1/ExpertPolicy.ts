// Original file: ../../proto/palr_gym/v1/policy.proto


export interface ExpertPolicy {
}

export interface ExpertPolicy__Output {
}
