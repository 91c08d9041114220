// Original file: ../../proto/palr_gym/v1/environment.proto
export const Mask = {
    MASK_UNSPECIFIED: 'MASK_UNSPECIFIED',
    MASK_FULL: 'MASK_FULL',
    MASK_PAPER: 'MASK_PAPER',
    MASK_STRICT: 'MASK_STRICT',
};
