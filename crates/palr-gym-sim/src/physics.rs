//! MuJoCo's model and data, and nothing of any task.

use std::sync::{Arc, OnceLock};

use mujoco_rs::prelude::{MjData, MjModel, MjtState};

use crate::divergence::Divergence;
use crate::error::SimError;
use crate::guard::{self, EngineError};

/// Everything that a step starts from.
const INTEGRATION_STATE: u32 = MjtState::mjSTATE_INTEGRATION as u32;

/// The state of one simulation. It lives on one thread at a time.
#[derive(Debug)]
pub struct Physics {
    model: Arc<MjModel>,
    data: MjData<Arc<MjModel>>,
    /// Where a reset composes the state from which it starts.
    start: Start,
    /// MuJoCo gave up in the middle: what is in `data` is good for nothing.
    is_broken: bool,
}

#[derive(Debug)]
struct Start {
    qpos: Vec<f64>,
    qvel: Vec<f64>,
}

/// A task's MJCF scene, compiled when it is first needed and then shared by all environments.
#[derive(Debug)]
pub struct Scene {
    task: &'static str,
    mjcf: &'static str,
    model: OnceLock<Result<Arc<MjModel>, SimError>>,
}

impl Scene {
    /// The scene `mjcf` of `task`, not compiled yet.
    pub(crate) const fn new(task: &'static str, mjcf: &'static str) -> Self {
        Self { task, mjcf, model: OnceLock::new() }
    }

    /// Tells scenes apart.
    pub(crate) fn crc(&self) -> u32 {
        crc32fast::hash(self.mjcf.as_bytes())
    }

    /// The compiled scene.
    ///
    /// # Errors
    /// [`SimError::Scene`] with MuJoCo's message; only a broken build can cause it.
    pub fn model(&self) -> Result<Arc<MjModel>, SimError> {
        self.model
            .get_or_init(|| {
                guard::install();
                MjModel::from_xml_string(self.mjcf).map(Arc::new).map_err(|error| SimError::Scene {
                    task: self.task,
                    message: error.to_string(),
                })
            })
            .clone()
    }
}

impl Physics {
    /// A simulation of `scene` at its initial state.
    ///
    /// # Errors
    /// [`SimError::Scene`], or [`SimError::Memory`] if MuJoCo cannot allocate.
    pub(crate) fn new(scene: &Scene) -> Result<Self, SimError> {
        let model = scene.model()?;
        let data = MjData::try_new(Arc::clone(&model))
            .map_err(|error| SimError::Memory { task: scene.task, message: error.to_string() })?;
        let start = Start { qpos: data.qpos().to_vec(), qvel: data.qvel().to_vec() };
        Ok(Self { model, data, start, is_broken: false })
    }

    /// Generalised positions.
    #[must_use]
    pub fn qpos(&self) -> &[f64] {
        self.data.qpos()
    }

    /// Generalised velocities.
    #[must_use]
    pub fn qvel(&self) -> &[f64] {
        self.data.qvel()
    }

    /// Position of a body's frame in the world, as of the last `mj_step` or `mj_forward`: after a
    /// step it lags `qpos` by one integration.
    #[must_use]
    pub fn body_position_m(&self, body: usize) -> [f64; 3] {
        self.data.xpos()[body]
    }

    /// Generalised positions of the model's initial state.
    #[must_use]
    pub fn initial_qpos(&self) -> &[f64] {
        self.model.qpos0()
    }

    /// The force of contacts on each body, the world included: torque, then force, in the frame of
    /// the centre of mass. As of the last step, for tasks that need them; zeros after a reset.
    #[must_use]
    pub fn contact_forces(&self) -> &[[f64; 6]] {
        self.data.cfrc_ext()
    }

    /// Back to the model's initial state, then moved by `perturb(qpos, qvel)`.
    ///
    /// # Errors
    /// If MuJoCo fails.
    pub(crate) fn reset(
        &mut self,
        perturb: impl FnOnce(&mut [f64], &mut [f64]),
    ) -> Result<(), EngineError> {
        self.clear()?;
        self.start.qpos.copy_from_slice(self.data.qpos());
        self.start.qvel.copy_from_slice(self.data.qvel());
        let Start { qpos, qvel } = &mut self.start;
        perturb(qpos, qvel);
        self.data.qpos_mut().copy_from_slice(&self.start.qpos);
        self.data.qvel_mut().copy_from_slice(&self.start.qvel);
        self.forward()
    }

    /// The model's initial state, without anything that follows from it.
    fn clear(&mut self) -> Result<(), EngineError> {
        if self.is_broken {
            self.data = MjData::try_new(Arc::clone(&self.model))
                .map_err(|error| EngineError { message: error.to_string() })?;
            self.is_broken = false;
        } else {
            self.data.reset();
        }
        Ok(())
    }

    /// Sets positions and velocities and computes what follows from them (`mj_forward`), as
    /// Gymnasium's `set_state` does.
    ///
    /// Lengths are those of [`qpos`](Self::qpos) and [`qvel`](Self::qvel).
    pub(crate) fn set_state(&mut self, qpos: &[f64], qvel: &[f64]) -> Result<(), EngineError> {
        self.data.qpos_mut().copy_from_slice(qpos);
        self.data.qvel_mut().copy_from_slice(qvel);
        self.forward()
    }

    fn forward(&mut self) -> Result<(), EngineError> {
        let done = guard::forward(&mut self.data);
        self.is_broken = done.is_err();
        done
    }

    /// Holds `action` for `frame_skip` physics steps.
    ///
    /// # Errors
    /// If MuJoCo fails; then only [`reset`](Self::reset) helps.
    pub(crate) fn step(&mut self, action: &[f32], frame_skip: u32) -> Result<(), EngineError> {
        for (control, &entry) in self.data.ctrl_mut().iter_mut().zip(action) {
            *control = f64::from(entry);
        }
        let done = guard::step(&mut self.data, frame_skip);
        self.is_broken = done.is_err();
        done
    }

    /// Like [`step`](Self::step), and then computes contact forces.
    ///
    /// # Errors
    /// If MuJoCo fails; then only [`reset`](Self::reset) helps.
    pub(crate) fn step_with_contact_forces(
        &mut self,
        action: &[f32],
        frame_skip: u32,
    ) -> Result<(), EngineError> {
        self.step(action, frame_skip)?;
        let done = guard::contact_forces(&mut self.data);
        self.is_broken = done.is_err();
        done
    }

    /// Numbers in a [`save`](Self::save).
    pub(crate) fn saved_len(&self) -> usize {
        self.model.state_size(INTEGRATION_STATE) + self.data.xpos().as_flattened().len()
    }

    /// Appends everything that decides what comes next: the state of integration, and the bodies'
    /// positions, which lag it and from which rewards may be taken.
    pub(crate) fn save(&self, values: &mut Vec<f64>) {
        values.extend_from_slice(&self.data.state(INTEGRATION_STATE));
        values.extend_from_slice(self.data.xpos().as_flattened());
    }

    /// Takes the [`saved_len`](Self::saved_len) numbers of a [`save`](Self::save) up again. Nothing
    /// is computed from them: that would bring up to date what lagged.
    ///
    /// # Errors
    /// If MuJoCo fails.
    pub(crate) fn restore(&mut self, values: &[f64]) -> Result<(), EngineError> {
        self.clear()?;
        let (state, positions) = values.split_at(self.model.state_size(INTEGRATION_STATE));
        self.data
            .set_state(state, INTEGRATION_STATE)
            .map_err(|error| EngineError { message: error.to_string() })?;
        self.data.xpos_mut().as_flattened_mut().copy_from_slice(positions);
        Ok(())
    }

    /// What is wrong with the state, if anything is.
    ///
    /// MuJoCo counts its warnings since the last reset; after some of them it has put the initial
    /// state in place of the one that went wrong.
    #[must_use]
    pub fn divergence(&self) -> Option<Divergence> {
        let warned = self.data.warning().iter().position(|warning| warning.number > 0);
        if let Some(index) = warned {
            return Some(Divergence::of_warning(index));
        }
        let is_finite = self.qpos().iter().chain(self.qvel()).all(|entry| entry.is_finite());
        (!is_finite).then_some(Divergence::NotFinite)
    }
}
