//! MuJoCo's model and data, and nothing of any task.

use std::sync::{Arc, OnceLock};

use mujoco_rs::prelude::{MjData, MjModel};

use crate::error::SimError;

/// The state of one simulation. It lives on one thread at a time.
#[derive(Debug)]
pub struct Physics {
    data: MjData<Arc<MjModel>>,
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

    /// The compiled scene.
    ///
    /// # Errors
    /// [`SimError::Scene`] with MuJoCo's message; only a broken build can cause it.
    pub fn model(&self) -> Result<Arc<MjModel>, SimError> {
        self.model
            .get_or_init(|| {
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
        MjData::try_new(scene.model()?)
            .map(|data| Self { data })
            .map_err(|error| SimError::Memory { task: scene.task, message: error.to_string() })
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

    /// Back to the model's initial state, then moved by `perturb(qpos, qvel)`.
    pub(crate) fn reset(&mut self, perturb: impl FnOnce(&mut [f64], &mut [f64])) {
        self.data.reset();
        let mut qpos = self.data.qpos().to_vec();
        let mut qvel = self.data.qvel().to_vec();
        perturb(&mut qpos, &mut qvel);
        self.set_state(&qpos, &qvel);
    }

    /// Sets positions and velocities and computes what follows from them (`mj_forward`), as
    /// Gymnasium's `set_state` does.
    ///
    /// Lengths are those of [`qpos`](Self::qpos) and [`qvel`](Self::qvel).
    pub(crate) fn set_state(&mut self, qpos: &[f64], qvel: &[f64]) {
        self.data.qpos_mut().copy_from_slice(qpos);
        self.data.qvel_mut().copy_from_slice(qvel);
        self.data.forward();
    }

    /// Holds `action` for `frame_skip` physics steps.
    pub(crate) fn step(&mut self, action: &[f32], frame_skip: u32) {
        for (control, &entry) in self.data.ctrl_mut().iter_mut().zip(action) {
            *control = f64::from(entry);
        }
        for _ in 0..frame_skip {
            self.data.step();
        }
    }
}
