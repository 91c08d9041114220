//! One environment: a task with mask, frame stack, time limit and generator.

use std::hash::{BuildHasher, RandomState};
use std::sync::Arc;

use palr_gym_core::random::Generator;
use palr_gym_core::{EnvSpec, FrameStack, ObservationKind};

use crate::divergence::Divergence;
use crate::error::SimError;
use crate::physics::{Physics, State};
use crate::render::{self, GlChoice, View};
use crate::sight::{ExtractorError, Sight};
use crate::snapshot::{Reader, SnapshotError, Writer, malformed};
use crate::tasks::Task;

/// Beyond this MuJoCo holds a number for a mistake (`mjMAXVAL`).
const MAX_CONTROL: f32 = 1e10;

/// What a step earned, time limit included.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transition {
    /// As the task defines it.
    pub reward: f64,
    /// The task ended the episode.
    pub terminated: bool,
    /// The time limit ended the episode, or the simulation diverged. Can be true together with
    /// `terminated`.
    pub truncated: bool,
    /// Why the simulation is no longer one of the task, if it is not. Then the reward is 0, the info
    /// NaN, and the observation still that of the step before.
    pub divergence: Option<Divergence>,
}

impl Transition {
    /// True if this step ended the episode.
    #[must_use]
    pub fn is_last(&self) -> bool {
        self.terminated || self.truncated
    }
}

/// What a snapshot says of one environment.
pub(crate) struct SavedEnv {
    /// [`Env::saved_len`] numbers.
    values: Vec<f64>,
    generator: Generator,
    elapsed_steps: u32,
}

/// A single environment. It does not reset by itself.
pub struct Env {
    task: &'static dyn Task,
    spec: Arc<EnvSpec>,
    state: State,
    /// Where the task measures its progress from: after a step that can lag `state`.
    position_m: [f64; 2],
    /// What the last reset reported.
    reset_info: Vec<f64>,
    generator: Generator,
    stack: FrameStack,
    full_observation: Vec<f64>,
    elapsed_steps: u32,
    sight: Sight,
    /// The agent's last picture, if it sees any.
    picture: Vec<u8>,
    /// The picture's features are not in the stack yet.
    is_picture_pending: bool,
    /// Somebody else sees to features, for several environments at once.
    leaves_features: bool,
}

impl Env {
    /// An environment in the model's initial state, with a generator that the system seeds.
    /// [`reset`](Self::reset) starts the first episode.
    ///
    /// # Errors
    /// [`SimError::Scene`] or [`SimError::Memory`].
    pub fn new(task: &'static dyn Task, spec: &Arc<EnvSpec>) -> Result<Self, SimError> {
        Self::seeing(task, spec, &Sight::default())
    }

    /// The same, with what makes pictures into observations; `spec` fits it ([`Sight::fit`]).
    ///
    /// # Errors
    /// As by [`new`](Self::new), or [`SimError::Extractor`] if an extractor is missing.
    pub fn seeing(
        task: &'static dyn Task,
        spec: &Arc<EnvSpec>,
        sight: &Sight,
    ) -> Result<Self, SimError> {
        sight.picture_size_px(spec)?;
        Ok(Self {
            task,
            state: task.scene().initial_state()?,
            position_m: [f64::NAN; 2],
            reset_info: vec![f64::NAN; spec.task.reset_info_names.len()],
            generator: Generator::from_seed(RandomState::new().hash_one(0)),
            stack: FrameStack::new(spec.frame_size(), spec.env_id.frame_stack),
            full_observation: vec![0.0; spec.task.observation.len()],
            spec: Arc::clone(spec),
            elapsed_steps: 0,
            sight: sight.clone(),
            picture: Vec::new(),
            is_picture_pending: false,
            leaves_features: false,
        })
    }

    /// Starts an episode: with a seed from a new generator, without one from where the old
    /// generator stands, as Gymnasium's `reset` does.
    ///
    /// # Errors
    /// [`SimError::Engine`] if MuJoCo fails, [`SimError::Render`] or [`SimError::Extractor`] if the
    /// agent sees nothing; then only another reset helps.
    pub fn reset(&mut self, seed: Option<u64>) -> Result<(), SimError> {
        if let Some(seed) = seed {
            self.generator = Generator::from_seed(seed);
        }
        self.task.scene().on_workbench(|physics| {
            let Self { task, generator, spec, .. } = self;
            physics.reset(|start| task.perturb(generator, &spec.scene, start))?;
            self.elapsed_steps = 0;
            self.stack.clear();
            self.task.reset_info(physics, &mut self.reset_info);
            self.take_down(physics);
            self.observe(physics)
        })??;
        self.see()
    }

    /// Puts the simulation into a state, keeping everything else. For tests against other
    /// simulators.
    ///
    /// # Errors
    /// [`SimError::Engine`] if MuJoCo fails.
    pub fn set_state(&mut self, qpos: &[f64], qvel: &[f64]) -> Result<(), SimError> {
        self.task.scene().on_workbench(|physics| {
            physics.load(&self.state)?;
            physics.set_state(qpos, qvel)?;
            self.take_down(physics);
            Ok(())
        })?
    }

    /// One step. `action` has `action_size` entries, `info` one for each of the task's names.
    pub fn step(&mut self, action: &[f32], info: &mut [f64]) -> Transition {
        self.elapsed_steps += 1;
        let truncated = self.elapsed_steps >= self.spec.task.max_episode_steps;
        let stepped = self.task.scene().on_workbench(|physics| {
            if let Some(divergence) = self.simulate(physics, action) {
                return Err(divergence);
            }
            self.task.advance(&mut self.generator, physics);
            let outcome = self.task.outcome(physics, self.position_m, action, info);
            self.task.draw_next(&mut self.generator, physics.userdata_mut());
            self.take_down(physics);
            self.observe(physics).map_err(|error| self.unseen(&error))?;
            Ok(outcome)
        });
        let stepped = stepped.unwrap_or_else(|error| Err(self.engine_error(&error)));
        match stepped
            .and_then(|outcome| self.see().map(|()| outcome).map_err(|error| self.unseen(&error)))
        {
            Ok(outcome) => Transition {
                reward: outcome.reward,
                terminated: outcome.terminated,
                truncated,
                divergence: None,
            },
            Err(divergence) => {
                info.fill(f64::NAN);
                let divergence = Some(divergence);
                Transition { reward: 0.0, terminated: false, truncated: true, divergence }
            }
        }
    }

    /// What the last reset reported, `reset_info_names` entries; NaN before the first.
    #[must_use]
    pub fn reset_info(&self) -> &[f64] {
        &self.reset_info
    }

    /// Numbers in a snapshot: state, position, full observation, stack.
    fn saved_len(&self) -> usize {
        self.state.values().len()
            + self.position_m.len()
            + self.full_observation.len()
            + self.stack.stacked().len()
    }

    /// Bytes in a snapshot.
    pub(crate) fn snapshot_len(&self) -> usize {
        self.saved_len() * size_of::<f64>() + 2 * size_of::<u128>() + size_of::<u32>()
    }

    /// Appends [`snapshot_len`](Self::snapshot_len) bytes.
    pub(crate) fn save(&self, writer: &mut Writer) {
        writer.f64s(self.state.values());
        writer.f64s(&self.position_m);
        writer.f64s(&self.full_observation);
        writer.f64s(self.stack.stacked());
        let (state, increment) = self.generator.state();
        writer.u128(state);
        writer.u128(increment);
        writer.u32(self.elapsed_steps);
    }

    /// What [`save`](Self::save) wrote, checked.
    pub(crate) fn read(&self, reader: &mut Reader<'_>) -> Result<SavedEnv, SnapshotError> {
        let mut values = vec![0.0; self.saved_len()];
        reader.f64s("state", &mut values)?;
        let (state, increment) = (reader.u128("generator")?, reader.u128("generator")?);
        let generator = Generator::from_state(state, increment)
            .ok_or_else(|| malformed("generator", increment, "an odd increment"))?;
        let elapsed_steps = reader.u32("elapsed_steps")?;
        let max = self.spec.task.max_episode_steps;
        if elapsed_steps > max {
            return Err(malformed("elapsed_steps", elapsed_steps, format!("at most {max}")));
        }
        Ok(SavedEnv { values, generator, elapsed_steps })
    }

    /// Goes on from where `saved` was.
    pub(crate) fn restore(&mut self, saved: SavedEnv) {
        let (state, rest) = saved.values.split_at(self.state.values().len());
        let (position_m, rest) = rest.split_at(self.position_m.len());
        let (full, stack) = rest.split_at(self.full_observation.len());
        self.state.copy_from(state);
        self.position_m.copy_from_slice(position_m);
        self.full_observation.copy_from_slice(full);
        self.stack.restore(stack);
        self.generator = saved.generator;
        self.elapsed_steps = saved.elapsed_steps;
        self.is_picture_pending = false;
    }

    fn simulate(&self, physics: &mut Physics, action: &[f32]) -> Option<Divergence> {
        // Actuators with limits would clamp it in silence, while its cost overflows.
        if action.iter().any(|entry| entry.abs() > MAX_CONTROL) {
            return Some(Divergence::BadControl);
        }
        let frame_skip = self.spec.task.frame_skip;
        let set_controls = |controls: &mut [f64]| self.task.controls(action, controls);
        let done = physics.load(&self.state).and_then(|()| {
            if self.task.needs_contact_forces() {
                physics.step_with_contact_forces(set_controls, frame_skip)
            } else {
                physics.step(set_controls, frame_skip)
            }
        });
        match done {
            Ok(()) => physics.divergence(),
            Err(error) => Some(self.engine_error(&error)),
        }
    }

    fn engine_error(&self, error: &dyn std::error::Error) -> Divergence {
        tracing::warn!(task = self.spec.task.name, "{error}; the episode is truncated");
        Divergence::EngineError
    }

    pub(crate) fn unseen(&self, error: &dyn std::error::Error) -> Divergence {
        tracing::warn!(task = self.spec.task.name, "{error}; the episode is truncated");
        Divergence::Unseen
    }

    /// Takes down what is on the bench as this environment's own.
    fn take_down(&mut self, physics: &Physics) {
        physics.store(&mut self.state);
        self.position_m = self.task.position_m(physics);
    }

    fn observe(&mut self, physics: &Physics) -> Result<(), SimError> {
        self.task.observe(physics, &mut self.full_observation);
        if self.spec.shows_pictures() {
            let (height_px, width_px) = self.sight.picture_size_px(&self.spec)?;
            let view = View { camera: self.spec.task.agent_camera, width_px, height_px };
            let (weather, pieces) = (self.task.weather(physics), self.task.pieces(physics));
            let look = (weather.as_ref(), pieces.as_ref());
            render::draw(self.sight.gl, physics, look, view, &mut self.picture)?;
        }
        match self.spec.observation {
            ObservationKind::State => {
                let indices = self.spec.mask_indices.iter();
                self.stack.push(indices.map(|&index| self.full_observation[index]));
            }
            ObservationKind::Pixels => self.stack.push(self.picture.iter().copied().map(f64::from)),
            ObservationKind::Features { .. } => self.is_picture_pending = true,
        }
        Ok(())
    }

    /// Brings the features of the last picture into the stack, unless somebody else does.
    fn see(&mut self) -> Result<(), SimError> {
        if self.is_picture_pending && !self.leaves_features {
            let mut features = Vec::new();
            self.sight.extractor()?.extract(&self.picture, 1, &mut features)?;
            self.take_features(&features);
        }
        Ok(())
    }

    /// From now on somebody else brings the features of its pictures: a
    /// [`Onlooker`](crate::Onlooker). Until it has, the observation is that of the step before.
    pub fn leave_features(&mut self) {
        self.leaves_features = true;
    }

    /// The picture whose features are not in the stack yet.
    pub(crate) fn pending_picture(&self) -> Option<&[u8]> {
        self.is_picture_pending.then_some(&self.picture)
    }

    /// Puts the features of the pending picture into the stack.
    pub(crate) fn take_features(&mut self, features: &[f32]) {
        self.stack.push(features.iter().copied().map(f64::from));
        self.is_picture_pending = false;
    }

    /// Goes on without features of the pending picture.
    pub(crate) fn forget_picture(&mut self) {
        self.is_picture_pending = false;
    }

    /// Features of pictures, for several environments at once.
    pub(crate) fn extract(
        &self,
        pictures: &[u8],
        count: usize,
        features: &mut Vec<f32>,
    ) -> Result<(), ExtractorError> {
        self.sight.extractor()?.extract(pictures, count, features)
    }

    /// The masked, stacked observation.
    #[must_use]
    pub fn observation(&self) -> &[f64] {
        self.stack.stacked()
    }

    /// The whole observation, for experts only: an agent must never see it.
    #[must_use]
    pub fn full_observation(&self) -> &[f64] {
        &self.full_observation
    }

    /// Writes the action of the task's own controller; `false` if it has none.
    pub fn controller(&self, action: &mut [f32]) -> bool {
        self.task.controller(&self.full_observation, action)
    }

    /// Draws the simulation as it stands: `[height, width, 3]`, from the top row down.
    ///
    /// # Errors
    /// [`SimError::Render`], or what keeps a thread from having a workbench.
    pub fn draw(
        &self,
        choice: GlChoice,
        view: View<'_>,
        picture: &mut Vec<u8>,
    ) -> Result<(), SimError> {
        let camera = view.camera.or(self.task.spec().camera_names.first().copied());
        let view = View { camera, ..view };
        self.task.scene().on_workbench(|physics| {
            physics.load(&self.state)?;
            let (weather, pieces) = (self.task.weather(physics), self.task.pieces(physics));
            let look = (weather.as_ref(), pieces.as_ref());
            Ok(render::draw(choice, physics, look, view, picture)?)
        })?
    }

    /// The simulation's state.
    #[must_use]
    pub fn state(&self) -> &State {
        &self.state
    }
}
