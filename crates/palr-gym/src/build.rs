//! What this program was built from.

/// The commit, if it was built in a git repository; `-dirty` is not told.
pub const GIT_REVISION: Option<&str> = option_env!("PALR_GYM_GIT_REVISION");
