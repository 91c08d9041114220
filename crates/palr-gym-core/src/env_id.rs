//! Environment ids: `TASK[-full|-paper|-strict|-pixels][-gym5][-wN][-v0]`.

use std::fmt;
use std::str::FromStr;

use crate::options::{Fidelity, Mask};

/// The deepest stack that can be asked for.
pub const MAX_FRAME_STACK: usize = 64;

/// What an environment id says, with every default filled in.
///
/// Without a mask, `-wN` means the paper's mask and its absence the full observation: `hopper` is
/// what an expert sees, `hopper-w2` is the paper's POMDP with a stack of two.
///
/// ```
/// use palr_gym_core::{EnvId, Mask};
/// let env_id: EnvId = "hopper-w2".parse()?;
/// assert_eq!((env_id.mask, env_id.frame_stack), (Mask::Paper, 2));
/// assert_eq!(env_id.to_string(), "hopper-w2-v0");
/// # Ok::<(), palr_gym_core::EnvIdError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct EnvId {
    /// Name of the task. That it exists is for the registry of tasks to say.
    pub task: String,
    /// What the agent sees of the full observation.
    pub mask: Mask,
    /// Which definition of the task.
    pub fidelity: Fidelity,
    /// Observations in a stack, 1 to [`MAX_FRAME_STACK`].
    pub frame_stack: usize,
}

/// Why a text is no environment id.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum EnvIdError {
    /// No task name.
    #[error(
        "environment id {env_id:?} names no task; expected TASK[-full|-paper|-strict|-pixels][-gym5][-wN][-v0], such as \"hopper-w2\""
    )]
    NoTask {
        /// The whole id.
        env_id: String,
    },
    /// A part that means nothing, or comes twice.
    #[error(
        "environment id {env_id:?} has the unexpected part {part:?}; expected TASK[-full|-paper|-strict|-pixels][-gym5][-wN][-v0], such as \"hopper-w2\""
    )]
    UnexpectedPart {
        /// The whole id.
        env_id: String,
        /// The part that was not understood.
        part: String,
    },
    /// Too shallow or too deep a stack.
    #[error(
        "environment id {env_id:?} asks for a frame stack of {got}; expected 1 to {MAX_FRAME_STACK}"
    )]
    FrameStack {
        /// The whole id.
        env_id: String,
        /// The depth as it was written.
        got: String,
    },
    /// A version that was never published.
    #[error("environment id {env_id:?} asks for version {got}; the only version is v0")]
    Version {
        /// The whole id.
        env_id: String,
        /// The version as it was written.
        got: String,
    },
}

/// What one part of an id after the task's name says.
enum Part {
    Mask(Mask),
    Fidelity(Fidelity),
    FrameStack(usize),
    Version,
}

fn parse_part(env_id: &str, part: &str) -> Result<Part, EnvIdError> {
    if let Some(mask) = Mask::ALL.into_iter().find(|mask| mask.name() == part) {
        return Ok(Part::Mask(mask));
    }
    if Fidelity::Gym5.suffix().strip_prefix('-') == Some(part) {
        return Ok(Part::Fidelity(Fidelity::Gym5));
    }
    let number = |prefix| {
        part.strip_prefix(prefix)
            .filter(|digits| !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit()))
    };
    if let Some(digits) = number('w') {
        return match digits.parse() {
            Ok(depth @ 1..=MAX_FRAME_STACK) => Ok(Part::FrameStack(depth)),
            _ => Err(EnvIdError::FrameStack { env_id: env_id.into(), got: digits.into() }),
        };
    }
    if let Some(digits) = number('v') {
        return match digits {
            "0" => Ok(Part::Version),
            _ => Err(EnvIdError::Version { env_id: env_id.into(), got: part.into() }),
        };
    }
    Err(EnvIdError::UnexpectedPart { env_id: env_id.into(), part: part.into() })
}

impl FromStr for EnvId {
    type Err = EnvIdError;

    fn from_str(env_id: &str) -> Result<Self, EnvIdError> {
        let mut parts = env_id.split('-');
        let task = parts.next().filter(|task| !task.is_empty());
        let Some(task) = task else {
            return Err(EnvIdError::NoTask { env_id: env_id.into() });
        };
        let (mut mask, mut fidelity, mut frame_stack, mut has_version) = (None, None, None, false);
        for part in parts {
            let is_repeated = match parse_part(env_id, part)? {
                Part::Mask(value) => {
                    let is_late = fidelity.is_some() || frame_stack.is_some() || has_version;
                    mask.replace(value).is_some() || is_late
                }
                Part::Fidelity(value) => {
                    fidelity.replace(value).is_some() || frame_stack.is_some() || has_version
                }
                Part::FrameStack(value) => frame_stack.replace(value).is_some() || has_version,
                Part::Version => std::mem::replace(&mut has_version, true),
            };
            if is_repeated {
                return Err(EnvIdError::UnexpectedPart {
                    env_id: env_id.into(),
                    part: part.into(),
                });
            }
        }
        let default_mask = if frame_stack.is_some() { Mask::Paper } else { Mask::Full };
        Ok(Self {
            task: task.into(),
            mask: mask.unwrap_or(default_mask),
            fidelity: fidelity.unwrap_or_default(),
            frame_stack: frame_stack.unwrap_or(1),
        })
    }
}

impl fmt::Display for EnvId {
    /// The shortest id that parses back to the same value, with its version.
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { task, mask, fidelity, frame_stack } = self;
        let fidelity = fidelity.suffix();
        match (mask, frame_stack) {
            (Mask::Full, 1) => write!(formatter, "{task}{fidelity}-v0"),
            (Mask::Paper, _) => write!(formatter, "{task}{fidelity}-w{frame_stack}-v0"),
            _ => write!(formatter, "{task}-{mask}{fidelity}-w{frame_stack}-v0"),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn check(text: &str, expected: Result<(&str, Mask, usize), &str>) {
        let got = text.parse::<EnvId>();
        match (got, expected) {
            (Ok(id), Ok((task, mask, frame_stack))) => {
                let fidelity = if text.contains("-gym5") { Fidelity::Gym5 } else { Fidelity::Gym4 };
                assert_eq!(id, EnvId { task: task.into(), mask, fidelity, frame_stack }, "{text}");
            }
            (Err(error), Err(expected)) => {
                assert!(error.to_string().contains(expected), "{text}: {error}");
            }
            (got, expected) => panic!("{text}: got {got:?}, expected {expected:?}"),
        }
    }

    #[test]
    fn ids_mean_what_the_grammar_says() {
        check("hopper", Ok(("hopper", Mask::Full, 1)));
        check("hopper-v0", Ok(("hopper", Mask::Full, 1)));
        check("hopper-w2", Ok(("hopper", Mask::Paper, 2)));
        check("hopper-w64-v0", Ok(("hopper", Mask::Paper, 64)));
        check("ant-strict", Ok(("ant", Mask::Strict, 1)));
        check("ant-full-w4", Ok(("ant", Mask::Full, 4)));
        check("lane-pixels-w3", Ok(("lane", Mask::Pixels, 3)));
        check("ant-gym5", Ok(("ant", Mask::Full, 1)));
        check("ant-gym5-w4", Ok(("ant", Mask::Paper, 4)));
        check("ant-strict-gym5-w4-v0", Ok(("ant", Mask::Strict, 4)));
        check("", Err("names no task"));
        check("-w2", Err("names no task"));
        check("hopper-w0", Err("frame stack of 0; expected 1 to 64"));
        check("hopper-w10000", Err("frame stack of 10000"));
        check("hopper-w99999999999999999999999", Err("frame stack of 9999"));
        check("hopper-v3", Err("version v3; the only version is v0"));
        check("hopper-blurred", Err("unexpected part \"blurred\""));
        check("hopper-w", Err("unexpected part \"w\""));
        check("hopper-w2-w3", Err("unexpected part \"w3\""));
        check("hopper-w2-strict", Err("unexpected part \"strict\""));
        check("hopper-gym5-strict", Err("unexpected part \"strict\""));
        check("hopper-w2-gym5", Err("unexpected part \"gym5\""));
        check("hopper-gym5-gym5", Err("unexpected part \"gym5\""));
        check("hopper-gym6", Err("unexpected part \"gym6\""));
        check("hopper--w2", Err("unexpected part \"\""));
    }

    proptest! {
        #[test]
        fn display_parses_back(task in "[a-z0-9_]{1,12}", mask in 0..4usize, fidelity in 0..2usize, frame_stack in 1..=MAX_FRAME_STACK) {
            let id = EnvId { task, mask: Mask::ALL[mask], fidelity: Fidelity::ALL[fidelity], frame_stack };
            prop_assert_eq!(id.to_string().parse::<EnvId>(), Ok(id));
        }

        #[test]
        fn parsing_never_panics(text in ".{0,40}") {
            let _ = text.parse::<EnvId>();
        }
    }
}
