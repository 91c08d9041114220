//! The methods, one file each.
//!
//! A method says which networks it has, how a step changes them, and which of them act. Policy,
//! likelihood, data, random numbers, checkpoints and the loop are shared: a new method is a file
//! here, a table of settings with its file in `trainer/configs/`, and a line in [`method`].

pub mod bc;
pub mod dt;
pub mod dt_palr;
pub mod fca;
pub mod kf;
pub mod mine;
pub mod palr;
pub mod palr_act;
pub mod primenet;
pub mod rap;
pub mod vib;

use crate::learning::architecture::Architecture;
use crate::learning::config::Algorithm;
use crate::learning::context::Context;
use crate::learning::error::TrainError;
use crate::learning::network::Network;
use crate::learning::state::State;

/// What a step saw before it changed anything.
#[derive(Debug, Clone, PartialEq)]
pub struct StepReport {
    /// Mean negative log-likelihood of the batch, in nats.
    pub nll: f64,
    /// HSCIC of the regularised rows, if the method has it.
    pub hscic: Option<f64>,
    /// The method's other terms, by name.
    pub terms: Vec<(&'static str, f64)>,
}

impl StepReport {
    /// Of a method with the likelihood alone.
    #[must_use]
    pub fn new(nll: f64) -> Self {
        Self { nll, hscic: None, terms: Vec::new() }
    }

    /// With another term.
    #[must_use]
    pub fn with(mut self, name: &'static str, value: f64) -> Self {
        self.terms.push((name, value));
        self
    }

    /// Refuses terms that are not finite, in step number `step`, from 1.
    ///
    /// # Errors
    /// [`TrainError::Diverged`].
    pub fn check(&self, step: u64) -> Result<(), TrainError> {
        let hscic = self.hscic.map(|value| ("HSCIC of the batch", value));
        let all = [("the batch's negative log-likelihood", self.nll)];
        for (name, value) in all.into_iter().chain(hscic).chain(self.terms.iter().copied()) {
            if !value.is_finite() {
                return Err(TrainError::Diverged { step, tensor: name.to_owned(), value });
            }
        }
        Ok(())
    }
}

/// A way to learn.
///
/// All that later steps depend on is in [`State`] or follows from settings and data, so that a run
/// which goes on from a stored state has the bits of one that was never interrupted.
pub trait Method {
    /// The networks before step 1.
    fn start(&self) -> State;

    /// Takes the step after `state`, or a part of what has to come before the first one: then
    /// there is no report. Does not count the step.
    ///
    /// # Errors
    /// [`TrainError::Diverged`], [`TrainError::Singular`] or [`TrainError::Tensor`].
    fn step(&mut self, state: &mut State) -> Result<Option<StepReport>, TrainError>;

    /// The policy's.
    fn architecture(&self) -> Architecture;

    /// The parameters of the networks that act, in the architecture's order.
    fn acting_parameters(&self, state: &State) -> Vec<f32> {
        let parts = self.architecture().networks();
        let networks = parts.iter().filter_map(|(name, _)| state.network(name));
        networks.flat_map(|network| network.parameters.iter().copied()).collect()
    }
}

/// The method that the settings name.
#[must_use]
pub fn method<'a>(context: Context<'a>) -> Box<dyn Method + 'a> {
    match context.config.algorithm {
        Algorithm::Bc => Box::new(bc::Bc::new(context)),
        Algorithm::Kf => Box::new(kf::Kf::new(context)),
        Algorithm::Primenet => Box::new(primenet::Primenet::new(context)),
        Algorithm::Rap => Box::new(rap::Rap::new(context)),
        Algorithm::Fca => Box::new(fca::Fca::new(context)),
        Algorithm::Mine => Box::new(mine::Mine::new(context)),
        Algorithm::Palr => Box::new(palr::Palr::new(context)),
        Algorithm::PalrAct => Box::new(palr_act::PalrAct::new(context)),
        Algorithm::Vib => Box::new(vib::Vib::new(context)),
        Algorithm::Dt => Box::new(dt::Dt::new(context)),
        Algorithm::DtPalr => Box::new(dt_palr::DtPalr::new(context)),
    }
}

/// With which [`Method::start`] begins.
fn state(networks: Vec<Network>) -> State {
    State { step: 0, networks, scalars: Vec::new() }
}
