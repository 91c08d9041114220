//! Choices that a user makes about an environment, named as the field names them.

use std::fmt;

/// Which entries of the full observation the agent sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Mask {
    /// Every entry.
    Full,
    /// The entries that the PALR paper keeps (section C.1). For halfcheetah these include five
    /// velocities.
    Paper,
    /// Positions only.
    Strict,
}

impl Mask {
    /// Every mask, in the order in which they are listed to users.
    pub const ALL: [Self; 3] = [Self::Full, Self::Paper, Self::Strict];

    /// The word that stands for it in an environment id.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::Paper => "paper",
            Self::Strict => "strict",
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
