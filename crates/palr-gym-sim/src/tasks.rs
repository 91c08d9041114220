//! The registry of tasks: scene file, task module and entry here stand one to one.

mod ant;
mod driving;
mod halfcheetah;
mod hopper;
mod lane;
mod locomotion;
mod town;
mod toy;
mod walker2d;

use palr_gym_core::nearest::nearest;
use palr_gym_core::random::Generator;
use palr_gym_core::{
    EnvId, EnvSpec, Fidelity, Mask, SceneOption, SceneOptions, SceneOptionsError, TaskSpec,
};

use crate::error::SimError;
use crate::physics::{Physics, Scene, Start};
use crate::render::{Pieces, Weather};

pub use lane::scene_mjcf as lane_scene_mjcf;
pub use town::scene_mjcf as town_scene_mjcf;

/// What a step earned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// As the task defines it, in f64.
    pub reward: f64,
    /// The task ended the episode.
    pub terminated: bool,
}

/// A task: what a simulation means.
pub trait Task: Send + Sync {
    /// Names, sizes, masks and limits.
    fn spec(&self) -> &'static TaskSpec;

    /// The scene.
    fn scene(&self) -> &'static Scene;

    /// True if contact forces must be computed after each step.
    fn needs_contact_forces(&self) -> bool {
        false
    }

    /// What can be chosen about the scene.
    fn scene_options(&self) -> &'static [SceneOption] {
        &[]
    }

    /// Moves the initial state to where an episode starts, drawing from `generator` in
    /// Gymnasium's order.
    fn perturb(&self, generator: &mut Generator, options: &SceneOptions, start: &mut Start);

    /// What `action` asks of the actuators.
    fn controls(&self, action: &[f32], controls: &mut [f64]) {
        for (control, &entry) in controls.iter_mut().zip(action) {
            *control = f64::from(entry);
        }
    }

    /// What happens beside the physics in each step, after it and before anything is looked at.
    fn advance(&self, _generator: &mut Generator, _physics: &mut Physics) {}

    /// Draws what chance decides in the course of an episode, after each step, once it is paid and
    /// before it is looked at. `userdata` is what the task remembers.
    fn draw_next(&self, _generator: &mut Generator, _userdata: &mut [f64]) {}

    /// Writes the full observation, `spec().observation` entries.
    fn observe(&self, physics: &Physics, observation: &mut [f64]);

    /// The positions (x, y) from which the reward's velocity is taken, in metres.
    fn position_m(&self, physics: &Physics) -> [f64; 2];

    /// Reward and end of the step that began at `before_m` with `action` and led to `physics`.
    /// Writes `spec().info_names` entries to `info`.
    fn outcome(
        &self,
        physics: &Physics,
        before_m: [f64; 2],
        action: &[f32],
        info: &mut [f64],
    ) -> Outcome;

    /// Light, fog and colours of the episode; `None`: as the scene has them.
    fn weather(&self, _physics: &Physics) -> Option<Weather> {
        None
    }

    /// Which pieces of the scene are there; `None`: all.
    fn pieces(&self, _physics: &Physics) -> Option<Pieces> {
        None
    }

    /// Writes what a reset that led to `physics` reports: `spec().reset_info_names` entries.
    fn reset_info(&self, _physics: &Physics, _info: &mut [f64]) {}

    /// The action of the task's own controller in a state (a full observation), if it has one: an
    /// expert that is no model.
    fn controller(&self, _observation: &[f64], _action: &mut [f32]) -> bool {
        false
    }

    /// True if [`controller`](Self::controller) acts.
    fn has_controller(&self) -> bool {
        false
    }
}

/// Every task, in alphabetical order; where Gymnasium has it, as `-v4` defines it.
pub static TASKS: [&dyn Task; 7] = [
    &ant::Ant(Fidelity::Gym4),
    &halfcheetah::Halfcheetah(Fidelity::Gym4),
    &hopper::Hopper(Fidelity::Gym4),
    &lane::Lane,
    &town::Town,
    &toy::Toy,
    &walker2d::Walker2d(Fidelity::Gym4),
];

/// Gymnasium's tasks as `-v5` defines them.
pub static TASKS_GYM5: [&dyn Task; 4] = [
    &ant::Ant(Fidelity::Gym5),
    &halfcheetah::Halfcheetah(Fidelity::Gym5),
    &hopper::Hopper(Fidelity::Gym5),
    &walker2d::Walker2d(Fidelity::Gym5),
];

/// The tasks of a fidelity.
#[must_use]
pub fn tasks(fidelity: Fidelity) -> &'static [&'static dyn Task] {
    match fidelity {
        Fidelity::Gym4 => &TASKS,
        Fidelity::Gym5 => &TASKS_GYM5,
    }
}

/// The task and environment that an id such as `hopper-w2` names.
///
/// # Errors
/// [`SimError::EnvId`], [`SimError::UnknownTask`] or [`SimError::View`].
pub fn resolve(env_id: &str) -> Result<(&'static dyn Task, EnvSpec), SimError> {
    let env_id: EnvId = env_id.parse()?;
    let find = |fidelity| tasks(fidelity).iter().find(|task| task.spec().name == env_id.task);
    let Some(task) = find(env_id.fidelity).or_else(|| find(Fidelity::default())) else {
        let names = || TASKS.iter().map(|task| task.spec().name);
        return Err(SimError::UnknownTask {
            suggestion: nearest(&env_id.task, names()),
            known: names().collect(),
            task: env_id.task,
        });
    };
    let spec = task.spec();
    let view = |asked: &'static str, available: Vec<&'static str>| {
        Err(SimError::View { task: spec.name, asked, available })
    };
    if spec.fidelity != env_id.fidelity {
        return view("gym5", Vec::new());
    }
    if !spec.masks().any(|mask| mask == env_id.mask) {
        return view(env_id.mask.name(), spec.masks().map(Mask::name).collect());
    }
    Ok((*task, EnvSpec::new(env_id, spec)))
}

/// The same, with options about its scene.
///
/// # Errors
/// As by [`resolve`], or [`SimError::SceneOptions`].
pub fn resolve_scene(
    env_id: &str,
    options: Option<SceneOptions>,
) -> Result<(&'static dyn Task, EnvSpec), SimError> {
    let (task, mut spec) = resolve(env_id)?;
    if let Some(options) = options {
        let (name, available) = (spec.task.name, task.scene_options());
        if available.is_empty() {
            return Err(SceneOptionsError::NoScene { task: name }.into());
        }
        let is_foreign =
            |option: &SceneOption| options.chooses(*option) && !available.contains(option);
        if let Some(option) = SceneOption::ALL.into_iter().find(is_foreign) {
            let available = available.iter().copied().map(SceneOption::name).collect();
            let name = option.name();
            return Err(
                SceneOptionsError::NotOfTask { task: spec.task.name, name, available }.into()
            );
        }
        options.validate()?;
        spec.scene = options;
    }
    Ok((task, spec))
}

#[cfg(test)]
mod tests;
