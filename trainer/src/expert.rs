//! Experts, trained from nothing by soft actor-critic on a server's environments.
//!
//! # Layout
//! - [`settings`]: what decides a run.
//! - [`agent`]: the networks and their update; [`actor`], [`critic`] and [`mlp`] are its parts.
//! - [`replay`], [`collector`]: transitions, and the environments that they come from;
//!   [`perturbation`]: pushes on these.
//! - [`run`]: the loop, in a folder of its own, with its [`records`]; [`checkpoint`] is how it survives being killed.
//! - [`export`]: the finished policy; [`card`]: what is known about it; [`fitness`]: whether it can be
//!   imitated.
//!
//! Simulation costs a hundredth of an update, so many environments are stepped side by side and
//! there are fewer updates than transitions: what is learned from is fresher than with one update a
//! step, at no cost.

pub mod actor;
pub mod agent;
pub mod card;
pub mod checkpoint;
pub mod collector;
pub mod critic;
pub mod export;
pub mod fitness;
pub mod mlp;
pub mod perturbation;
pub mod records;
pub mod replay;
pub mod run;
pub mod settings;

pub use critic::CriticKind;
pub use run::{Event, ExpertRun, Outcome};
pub use settings::ExpertSettings;
