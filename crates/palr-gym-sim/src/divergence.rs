//! How a simulation goes wrong.

use std::fmt;

/// Why an episode was cut short: the simulation is no longer one of the task, or nothing is seen of
/// it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Divergence {
    /// MuJoCo found the inertia matrix not positive definite.
    Inertia,
    /// More contacts than there is room for.
    ContactsFull,
    /// More constraints than there is room for.
    ConstraintsFull,
    /// A position that is no number, or huge (beyond ±1e10).
    BadPosition,
    /// A velocity that is no number, or huge.
    BadVelocity,
    /// An acceleration that is no number, or huge.
    BadAcceleration,
    /// A control that is no number, or huge.
    BadControl,
    /// The state is no longer finite.
    NotFinite,
    /// MuJoCo gave up with an error.
    EngineError,
    /// The agent's picture could not be drawn, or its features are no numbers.
    Unseen,
}

impl Divergence {
    /// Every one, in the order of their numbers on the wire.
    pub const ALL: [Self; 10] = [
        Self::Inertia,
        Self::ContactsFull,
        Self::ConstraintsFull,
        Self::BadPosition,
        Self::BadVelocity,
        Self::BadAcceleration,
        Self::BadControl,
        Self::NotFinite,
        Self::EngineError,
        Self::Unseen,
    ];

    /// The word for it in infos.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Inertia => "inertia",
            Self::ContactsFull => "contacts_full",
            Self::ConstraintsFull => "constraints_full",
            Self::BadPosition => "bad_position",
            Self::BadVelocity => "bad_velocity",
            Self::BadAcceleration => "bad_acceleration",
            Self::BadControl => "bad_control",
            Self::NotFinite => "not_finite",
            Self::EngineError => "engine_error",
            Self::Unseen => "unseen",
        }
    }

    /// MuJoCo's warning `index` (`mjtWarning`).
    pub(crate) const fn of_warning(index: usize) -> Self {
        match index {
            0 => Self::Inertia,
            1 => Self::ContactsFull,
            2 => Self::ConstraintsFull,
            3 => Self::BadPosition,
            4 => Self::BadVelocity,
            5 => Self::BadAcceleration,
            _ => Self::BadControl,
        }
    }
}

impl fmt::Display for Divergence {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}
