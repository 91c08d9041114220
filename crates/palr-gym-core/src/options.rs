//! Choices that a user makes about an environment, named as the field names them.

use std::fmt;

/// What the agent sees of a task: entries of the full observation, or pictures of the scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Mask {
    /// Every entry.
    Full,
    /// What the PALR paper shows: entries of the full observation (section C.1; for halfcheetah
    /// these include five velocities), or, of a driving task, features of the driver's picture.
    Paper,
    /// Positions only.
    Strict,
    /// The driver's picture.
    Pixels,
}

impl Mask {
    /// Every mask, in the order in which they are listed to users.
    pub const ALL: [Self; 4] = [Self::Full, Self::Paper, Self::Strict, Self::Pixels];

    /// True if it means pictures, or features of them, where a task has an agent's camera.
    #[must_use]
    pub const fn shows_pictures(self) -> bool {
        matches!(self, Self::Paper | Self::Pixels)
    }

    /// The word that stands for it in an environment id.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::Paper => "paper",
            Self::Strict => "strict",
            Self::Pixels => "pixels",
        }
    }
}

impl fmt::Display for Mask {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

/// Which of Gymnasium's definitions of a task is meant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Fidelity {
    /// `-v4`: the arithmetic of D4RL's data.
    #[default]
    Gym4,
    /// `-v5`: no bonus on the failing step, more in the infos; other observations for ant, another
    /// robot for walker2d.
    Gym5,
}

impl Fidelity {
    /// Both, in the order in which they are listed to users.
    pub const ALL: [Self; 2] = [Self::Gym4, Self::Gym5];

    /// What stands for it in an environment id, with its hyphen; empty for the default.
    #[must_use]
    pub const fn suffix(self) -> &'static str {
        match self {
            Self::Gym4 => "",
            Self::Gym5 => "-gym5",
        }
    }
}

/// What happens to an environment whose episode has ended (`gymnasium.vector.AutoresetMode`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum AutoresetMode {
    /// The next step ignores its action and resets.
    #[default]
    NextStep,
    /// The ending step resets at once and hands out the final observation beside the new one.
    SameStep,
    /// The caller resets; stepping an ended environment is refused.
    Disabled,
}

/// What happens to an action outside the action space. NaN is always refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum OutOfBounds {
    /// The step is refused and changes nothing.
    #[default]
    Reject,
    /// Clipped before dynamics and control cost, as in the paper's evaluation.
    Clip,
    /// Used as it is, as in Gymnasium.
    Raw,
}

/// How actions are taken from a policy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum ActionMode {
    /// The policy's `action` output.
    #[default]
    Deterministic,
    /// `tanh(mean + exp(log_std) * N(0, 1))`.
    Sampled,
}

impl ActionMode {
    /// The word for it in results and metadata.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Deterministic => "deterministic",
            Self::Sampled => "sampled",
        }
    }
}
