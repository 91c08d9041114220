// Original file: ../../proto/palr_gym/v1/environment.proto
export const OutOfBounds = {
    OUT_OF_BOUNDS_UNSPECIFIED: 'OUT_OF_BOUNDS_UNSPECIFIED',
    OUT_OF_BOUNDS_REJECT: 'OUT_OF_BOUNDS_REJECT',
    OUT_OF_BOUNDS_CLIP: 'OUT_OF_BOUNDS_CLIP',
    OUT_OF_BOUNDS_RAW: 'OUT_OF_BOUNDS_RAW',
};
