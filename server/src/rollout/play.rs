//! The loop that both evaluation and collection run.

use palr_gym_core::EnvSpec;
use palr_gym_core::random::Generator;
use palr_gym_sim::{Env, SimulationThreads, Task, Transition};
use rayon::prelude::*;
use tokio_util::sync::CancellationToken;

use super::actor::Actor;
use crate::error::ServerError;

/// Of the streams that an episode's seed opens, the one that actions are drawn from. (The
/// environment itself draws from the seed alone, as Gymnasium does.)
pub const STREAM_OF_ACTIONS: u64 = 1;

/// What to play.
pub struct Plan {
    /// The task.
    pub task: &'static dyn Task,
    /// As the policy sees it.
    pub spec: EnvSpec,
    /// Environments side by side, and rows in the policy's batch.
    pub num_envs: usize,
    /// Episode i is reset with seed + i.
    pub seed: u64,
    /// Where physics runs.
    pub threads: SimulationThreads,
    /// Ends the work early.
    pub cancelled: CancellationToken,
}

impl Plan {
    /// The environment's seed in episode `index`.
    #[must_use]
    pub fn seed_of(&self, index: u32) -> u64 {
        self.seed.wrapping_add(u64::from(index))
    }
}

/// One environment and the episode that it plays.
pub(super) struct Slot {
    pub(super) env: Env,
    pub(super) episode: Option<u32>,
    pub(super) generator: Generator,
    pub(super) action: Vec<f32>,
    pub(super) action_log_prob: Option<f64>,
    pub(super) info: Vec<f64>,
    pub(super) length: u32,
    pub(super) episode_return: f64,
}

impl Slot {
    pub(super) fn is_playing(&self) -> bool {
        self.episode.is_some()
    }
}

/// Someone who decides which episodes are played and looks on.
pub(super) trait Observer: Sync {
    /// What is kept for each slot.
    type Log: Default + Send;

    /// The next episode to start, given the number that are playing; `None` if there is none now.
    fn next_episode(&mut self, playing: usize) -> Option<u32>;

    /// Before a step: `slot` holds the observation and the action.
    fn before_step(&self, slot: &Slot, log: &mut Self::Log);

    /// After a step: `slot` holds what followed.
    fn after_step(&self, slot: &Slot, transition: Transition, log: &mut Self::Log);

    /// The slot's episode has ended. `false` ends the whole rollout.
    fn ended(&mut self, slot: &Slot, transition: Transition, log: Self::Log) -> bool;
}

/// Plays until the observer has no more episodes and none is playing.
///
/// # Errors
/// Whatever environments or policy fail with, or [`ServerError::Cancelled`].
pub(super) fn play<O: Observer>(
    plan: &Plan,
    actor: &mut Actor,
    observer: &mut O,
) -> Result<(), ServerError> {
    let mut slots = (0..plan.num_envs)
        .map(|_| {
            Ok(Slot {
                env: Env::new(plan.task, &plan.spec)?,
                episode: None,
                generator: Generator::from_seed(0),
                action: vec![0.0; plan.spec.action_size()],
                action_log_prob: None,
                info: vec![0.0; plan.spec.task.info_names.len()],
                length: 0,
                episode_return: 0.0,
            })
        })
        .collect::<Result<Vec<Slot>, ServerError>>()?;
    let mut logs: Vec<O::Log> = slots.iter().map(|_| O::Log::default()).collect();
    loop {
        if plan.cancelled.is_cancelled() {
            return Err(ServerError::Cancelled);
        }
        start_episodes(plan, &mut slots, observer);
        if !slots.iter().any(Slot::is_playing) {
            return Ok(());
        }
        actor.act(&mut slots)?;
        let looking = &*observer;
        let transitions: Vec<Option<Transition>> = plan.threads.run(|| {
            slots
                .par_iter_mut()
                .zip(&mut logs)
                .map(|(slot, log)| slot.is_playing().then(|| step(slot, looking, log)))
                .collect()
        });
        for (i, transition) in transitions.into_iter().enumerate() {
            let Some(transition) = transition.filter(Transition::is_last) else { continue };
            let log = std::mem::take(&mut logs[i]);
            if !observer.ended(&slots[i], transition, log) {
                return Ok(());
            }
            slots[i].episode = None;
        }
    }
}

fn start_episodes<O: Observer>(plan: &Plan, slots: &mut [Slot], observer: &mut O) {
    let playing = slots.iter().filter(|slot| slot.is_playing()).count();
    let free = slots.iter_mut().filter(|slot| !slot.is_playing());
    for (playing, slot) in (playing..).zip(free) {
        let Some(index) = observer.next_episode(playing) else { return };
        let seed = plan.seed_of(index);
        slot.episode = Some(index);
        slot.generator = Generator::from_seed_and_stream(seed, STREAM_OF_ACTIONS);
        slot.env.reset(Some(seed));
        slot.length = 0;
        slot.episode_return = 0.0;
    }
}

fn step<O: Observer>(slot: &mut Slot, observer: &O, log: &mut O::Log) -> Transition {
    observer.before_step(slot, log);
    let transition = slot.env.step(&slot.action, &mut slot.info);
    slot.length += 1;
    slot.episode_return += transition.reward;
    observer.after_step(slot, transition, log);
    transition
}
