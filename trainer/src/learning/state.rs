//! A run between two steps.

use crate::learning::network::Network;

/// Everything that later steps depend on besides settings and data.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// Steps taken.
    pub step: u64,
    /// The method's networks with their optimisers.
    pub networks: Vec<Network>,
    /// The method's other numbers.
    pub scalars: Vec<f64>,
}

impl State {
    /// The network with this name.
    #[must_use]
    pub fn network(&self, name: &str) -> Option<&Network> {
        self.networks.iter().find(|network| network.name == name)
    }
}
