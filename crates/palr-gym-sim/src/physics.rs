//! MuJoCo's model and data, and nothing of any task.

use std::cell::RefCell;
use std::sync::{Arc, OnceLock};

use mujoco_rs::prelude::{MjData, MjModel, MjtObjBase, MjtState};

use crate::divergence::Divergence;
use crate::error::SimError;
use crate::guard::{self, EngineError};

/// What an environment must keep: MuJoCo's state of integration without controls, which come with
/// each step, and without what no task ever touches (applied forces, active constraints).
pub const KEPT_STATE: u32 = MjtState::mjSTATE_FULLPHYSICS as u32
    | MjtState::mjSTATE_WARMSTART as u32
    | MjtState::mjSTATE_MOCAP_POS as u32
    | MjtState::mjSTATE_MOCAP_QUAT as u32
    | MjtState::mjSTATE_USERDATA as u32;

/// Scenes for which a thread keeps a workbench; beyond that the one it used longest ago goes.
const MAX_WORKBENCHES: usize = 32;

/// Everything that decides how a simulation goes on, and nothing that follows from it: a kilobyte
/// where MuJoCo's data take a megabyte.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// [`KEPT_STATE`]: time, qpos, qvel, and so on.
    values: Box<[f64]>,
    nq: usize,
    nv: usize,
}

impl State {
    /// Generalised positions.
    #[must_use]
    pub fn qpos(&self) -> &[f64] {
        &self.values[1..=self.nq]
    }

    /// Generalised velocities.
    #[must_use]
    pub fn qvel(&self) -> &[f64] {
        &self.values[1 + self.nq..][..self.nv]
    }

    /// All of it, as `mj_getState` orders [`KEPT_STATE`].
    #[must_use]
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Replaces it by as many numbers of another one.
    pub(crate) fn copy_from(&mut self, values: &[f64]) {
        self.values.copy_from_slice(values);
    }
}

/// A workbench for simulations of one scene: MuJoCo's data, into which a [`State`] is put to be
/// worked on.
///
/// Each thread has one for all environments of a scene. What a step touches then stays in that
/// core's cache whichever environment comes next, and an environment costs no more than its state.
/// Everything else in MuJoCo's data is computed from the state by each step, so nothing of one
/// environment is left for the next.
#[derive(Debug)]
pub struct Physics {
    model: Arc<MjModel>,
    data: MjData<Arc<MjModel>>,
    /// Where a reset composes the state from which it starts.
    start: Start,
    condition: Condition,
    /// The geom whose contacts are watched.
    watched: Option<i32>,
    /// It touched something in the last step.
    has_touched: bool,
}

/// What may be done with MuJoCo's data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Condition {
    Good,
    /// There are warnings of a simulation that went wrong.
    Spoiled,
    /// MuJoCo gave up in the middle.
    Broken,
}

/// Where an episode begins, as a task composes it from the model's initial state.
#[derive(Debug)]
pub struct Start {
    /// Generalised positions.
    pub qpos: Vec<f64>,
    /// Generalised velocities.
    pub qvel: Vec<f64>,
    /// Positions of the bodies that tasks move themselves, in metres.
    pub mocap_pos: Vec<[f64; 3]>,
    /// Their orientations.
    pub mocap_quat: Vec<[f64; 4]>,
    /// What the task remembers, as numbers; zeros at first.
    pub userdata: Vec<f64>,
}

/// A task's MJCF scene, compiled when it is first needed and then shared by all environments.
#[derive(Debug)]
pub struct Scene {
    task: &'static str,
    mjcf: &'static str,
    watched_geom: Option<&'static str>,
    model: OnceLock<Result<Arc<MjModel>, SimError>>,
    initial: OnceLock<Result<State, SimError>>,
}

thread_local! {
    /// This thread's workbenches, the last used one first.
    static WORKBENCHES: RefCell<Vec<(&'static Scene, Physics)>> = const { RefCell::new(Vec::new()) };
}

impl Scene {
    /// The scene `mjcf` of `task`, not compiled yet.
    pub(crate) const fn new(task: &'static str, mjcf: &'static str) -> Self {
        Self { task, mjcf, watched_geom: None, model: OnceLock::new(), initial: OnceLock::new() }
    }

    /// A scene in which the contacts of one geom are watched in every physics step
    /// ([`Physics::has_touched`]).
    pub(crate) const fn watching(
        task: &'static str,
        mjcf: &'static str,
        geom: &'static str,
    ) -> Self {
        let watched_geom = Some(geom);
        Self { task, mjcf, watched_geom, model: OnceLock::new(), initial: OnceLock::new() }
    }

    /// The state in which the model begins.
    ///
    /// # Errors
    /// [`SimError::Scene`], or [`SimError::Memory`] if MuJoCo cannot allocate.
    pub(crate) fn initial_state(&self) -> Result<State, SimError> {
        self.initial.get_or_init(|| Physics::new(self).map(|physics| physics.state())).clone()
    }

    /// Has `work` done on this thread's workbench for the scene. Allocates only the first time.
    ///
    /// # Errors
    /// [`SimError::Scene`], or [`SimError::Memory`] if MuJoCo cannot allocate.
    pub(crate) fn on_workbench<R>(
        &'static self,
        work: impl FnOnce(&mut Physics) -> R,
    ) -> Result<R, SimError> {
        WORKBENCHES.with_borrow_mut(|benches| {
            match benches.iter().position(|(scene, _)| std::ptr::eq(*scene, self)) {
                Some(0) => {}
                Some(index) => benches[..=index].rotate_right(1),
                None => {
                    benches.truncate(MAX_WORKBENCHES - 1);
                    benches.insert(0, (self, Physics::new(self)?));
                }
            }
            Ok(work(&mut benches[0].1))
        })
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
        let data = guard::make_data(&model)
            .map_err(|error| SimError::Memory { task: scene.task, message: error.message })?;
        let watched = scene
            .watched_geom
            .and_then(|name| model.name_to_id(MjtObjBase::mjOBJ_GEOM, name))
            .map(|id| id as i32);
        let start = Start {
            qpos: data.qpos().to_vec(),
            qvel: data.qvel().to_vec(),
            mocap_pos: data.mocap_pos().to_vec(),
            mocap_quat: data.mocap_quat().to_vec(),
            userdata: data.userdata().to_vec(),
        };
        Ok(Self { model, data, start, condition: Condition::Good, watched, has_touched: false })
    }

    /// The state as of now, in memory of its own.
    fn state(&self) -> State {
        let values = self.data.state(KEPT_STATE);
        State { values, nq: self.qpos().len(), nv: self.qvel().len() }
    }

    /// Puts `state` on the bench. Nothing is computed from it: a step does that.
    ///
    /// # Errors
    /// If MuJoCo fails.
    pub(crate) fn load(&mut self, state: &State) -> Result<(), EngineError> {
        if self.condition != Condition::Good {
            self.clear()?;
        }
        self.data
            .set_state(&state.values, KEPT_STATE)
            .map_err(|error| EngineError { message: error.to_string() })
    }

    /// Takes down the state on the bench.
    pub(crate) fn store(&self, state: &mut State) {
        self.data.read_state_into(KEPT_STATE, &mut state.values);
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

    /// What the task remembers.
    #[must_use]
    pub fn userdata(&self) -> &[f64] {
        self.data.userdata()
    }

    /// What the task remembers.
    pub(crate) fn userdata_mut(&mut self) -> &mut [f64] {
        self.data.userdata_mut()
    }

    /// Copies where the task wants the bodies that it moves itself.
    pub(crate) fn set_mocap(&mut self, positions_m: &[[f64; 3]], quaternions: &[[f64; 4]]) {
        self.data.mocap_pos_mut().copy_from_slice(positions_m);
        self.data.mocap_quat_mut().copy_from_slice(quaternions);
    }

    /// Positions and orientations of the bodies that the task moves itself.
    pub(crate) fn mocap(&self) -> (&[[f64; 3]], &[[f64; 4]]) {
        (self.data.mocap_pos(), self.data.mocap_quat())
    }

    /// The compiled scene.
    pub(crate) fn model(&self) -> &Arc<MjModel> {
        &self.model
    }

    /// Simulated seconds since the reset.
    #[must_use]
    pub fn time_s(&self) -> f64 {
        self.data.time()
    }

    /// True if the watched geom touched something in any physics step of the last step.
    #[must_use]
    pub fn has_touched(&self) -> bool {
        self.has_touched
    }

    /// Back to the model's initial state, then moved by `perturb`.
    ///
    /// # Errors
    /// If MuJoCo fails.
    pub(crate) fn reset(&mut self, perturb: impl FnOnce(&mut Start)) -> Result<(), EngineError> {
        self.clear()?;
        self.start.qpos.copy_from_slice(self.data.qpos());
        self.start.qvel.copy_from_slice(self.data.qvel());
        self.start.mocap_pos.copy_from_slice(self.data.mocap_pos());
        self.start.mocap_quat.copy_from_slice(self.data.mocap_quat());
        self.start.userdata.copy_from_slice(self.data.userdata());
        perturb(&mut self.start);
        self.data.qpos_mut().copy_from_slice(&self.start.qpos);
        self.data.qvel_mut().copy_from_slice(&self.start.qvel);
        self.data.mocap_pos_mut().copy_from_slice(&self.start.mocap_pos);
        self.data.mocap_quat_mut().copy_from_slice(&self.start.mocap_quat);
        self.data.userdata_mut().copy_from_slice(&self.start.userdata);
        self.has_touched = false;
        self.forward()
    }

    /// The model's initial state, without anything that follows from it.
    fn clear(&mut self) -> Result<(), EngineError> {
        if self.condition == Condition::Broken {
            self.data = guard::make_data(&self.model)?;
        } else {
            self.data.reset();
        }
        self.condition = Condition::Good;
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
        self.note(done)
    }

    /// Holds what `set_controls` writes for `frame_skip` physics steps.
    ///
    /// # Errors
    /// If MuJoCo fails; then only [`reset`](Self::reset) helps.
    pub(crate) fn step(
        &mut self,
        set_controls: impl FnOnce(&mut [f64]),
        frame_skip: u32,
    ) -> Result<(), EngineError> {
        set_controls(self.data.ctrl_mut());
        let done = match self.watched {
            None => guard::step(&mut self.data, frame_skip),
            Some(geom) => self.step_watching(geom, frame_skip),
        };
        self.note(done)
    }

    /// Looks at the contacts of each physics step: a touch may be over at the end of the last.
    fn step_watching(&mut self, geom: i32, frame_skip: u32) -> Result<(), EngineError> {
        self.has_touched = false;
        for _ in 0..frame_skip {
            guard::step(&mut self.data, 1)?;
            self.has_touched |=
                self.data.contact().iter().any(|contact| contact.geom.contains(&geom));
        }
        Ok(())
    }

    /// Like [`step`](Self::step), and then computes contact forces.
    ///
    /// # Errors
    /// If MuJoCo fails; then only [`reset`](Self::reset) helps.
    pub(crate) fn step_with_contact_forces(
        &mut self,
        set_controls: impl FnOnce(&mut [f64]),
        frame_skip: u32,
    ) -> Result<(), EngineError> {
        self.step(set_controls, frame_skip)?;
        let done = guard::contact_forces(&mut self.data);
        self.note(done)
    }

    fn note(&mut self, done: Result<(), EngineError>) -> Result<(), EngineError> {
        if done.is_err() {
            self.condition = Condition::Broken;
        }
        done
    }

    /// What is wrong with the state, if anything is. What it has spoilt on the bench is cleared before
    /// the next state comes.
    ///
    /// MuJoCo counts its warnings since the last [`clear`](Self::clear); after some of them it has
    /// put the initial state in place of the one that went wrong.
    pub(crate) fn divergence(&mut self) -> Option<Divergence> {
        let warned = self.data.warning().iter().position(|warning| warning.number > 0);
        let is_finite = || self.qpos().iter().chain(self.qvel()).all(|entry| entry.is_finite());
        let divergence = match warned {
            Some(index) => Divergence::of_warning(index),
            None if is_finite() => return None,
            None => Divergence::NotFinite,
        };
        self.condition = Condition::Spoiled;
        Some(divergence)
    }
}
