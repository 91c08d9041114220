//! The loop that both evaluation and collection run.

use std::sync::Arc;

use palr_gym_core::EnvSpec;
use palr_gym_core::random::Generator;
use palr_gym_sim::{Env, Part, Parts, Sight, SimError, SimulationThreads, Task, Transition};
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
    pub spec: Arc<EnvSpec>,
    /// How it sees.
    pub sight: Sight,
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

    /// Where agents see pictures: draws one, so that what is wrong with drawing is known before
    /// anything begins, and what draws is known too.
    ///
    /// # Errors
    /// Why there is no picture, or no features of it.
    pub fn take_first_look(&self) -> Result<(), ServerError> {
        if !self.spec.shows_pictures() {
            return Ok(());
        }
        let (task, spec, sight) = (self.task, Arc::clone(&self.spec), self.sight.clone());
        let (seen, see) = std::sync::mpsc::channel();
        self.threads.spawn(move || {
            let looked = Env::seeing(task, &spec, &sight).and_then(|mut env| env.reset(Some(0)));
            // Whoever asked waits.
            let _ = seen.send(looked);
        });
        let lost = |_| ServerError::Internal("a simulation thread was lost".into());
        Ok(see.recv().map_err(lost)??)
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

/// What is kept of a slot's episode while it is played, on the thread that simulates it.
pub(super) trait Log: Default + Send + 'static {
    /// Before a step: `slot` holds the observation and the action.
    fn before_step(&mut self, slot: &Slot);

    /// After a step: `slot` holds what followed.
    fn after_step(&mut self, slot: &Slot, transition: Transition);
}

/// Nothing is kept.
impl Log for () {
    fn before_step(&mut self, _: &Slot) {}

    fn after_step(&mut self, _: &Slot, _: Transition) {}
}

/// Someone who decides which episodes are played and takes their logs.
pub(super) trait Observer {
    /// What is kept of each episode.
    type Log: Log;

    /// The next episode to start, given the number that are playing; `None` if there is none now.
    fn next_episode(&mut self, playing: usize) -> Option<u32>;

    /// The slot's episode has ended. `false` ends the whole rollout.
    fn ended(&mut self, slot: &Slot, transition: Transition, log: Self::Log) -> bool;
}

/// A slot with its log: what a simulation thread works on.
pub(super) struct Seat<L> {
    pub(super) slot: Slot,
    log: L,
    order: Order,
    /// What the last step of a playing slot came to.
    transition: Option<Transition>,
    /// Why an episode could not begin.
    failure: Option<SimError>,
}

/// What a simulation thread does with a seat. Episodes begin there too: it draws what agents see.
#[derive(Clone, Copy)]
enum Order {
    /// Nothing.
    Rest,
    /// Begin an episode.
    Reset(u64),
    /// Step, if there is one.
    Step,
}

impl<L: Log> Part for Seat<L> {
    fn work(&mut self) {
        let Self { slot, log, order, transition, failure } = self;
        *transition = None;
        match *order {
            Order::Rest => {}
            Order::Reset(seed) => *failure = slot.env.reset(Some(seed)).err(),
            Order::Step => *transition = slot.is_playing().then(|| step(slot, log)),
        }
    }
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
    let seats = (0..plan.num_envs)
        .map(|_| {
            let slot = Slot {
                env: Env::seeing(plan.task, &plan.spec, &plan.sight)?,
                episode: None,
                generator: Generator::from_seed(0),
                action: vec![0.0; plan.spec.action_size()],
                action_log_prob: None,
                info: vec![0.0; plan.spec.task.info_names.len()],
                length: 0,
                episode_return: 0.0,
            };
            let (log, order) = (O::Log::default(), Order::Rest);
            Ok(Seat { slot, log, order, transition: None, failure: None })
        })
        .collect::<Result<Vec<_>, ServerError>>()?;
    let mut seats = Parts::new(seats, plan.threads.clone());
    loop {
        if plan.cancelled.is_cancelled() {
            return Err(ServerError::Cancelled);
        }
        start_episodes(plan, &mut seats, observer)?;
        if !seats.iter().any(|seat| seat.slot.is_playing()) {
            return Ok(());
        }
        actor.act(&seats)?;
        seats.iter().for_each(|mut seat| seat.order = Order::Step);
        seats.work();
        for mut seat in seats.iter() {
            let Seat { slot, log, transition, .. } = &mut *seat;
            let Some(transition) = transition.filter(Transition::is_last) else { continue };
            if !observer.ended(slot, transition, std::mem::take(log)) {
                return Ok(());
            }
            slot.episode = None;
        }
    }
}

fn start_episodes<O: Observer>(
    plan: &Plan,
    seats: &mut Parts<Seat<O::Log>>,
    observer: &mut O,
) -> Result<(), ServerError> {
    let playing = seats.iter().filter(|seat| seat.slot.is_playing()).count();
    let mut starts_any = false;
    seats.iter().for_each(|mut seat| seat.order = Order::Rest);
    let free = seats.iter().filter(|seat| !seat.slot.is_playing());
    for (playing, mut seat) in (playing..).zip(free) {
        let Some(index) = observer.next_episode(playing) else { break };
        let seed = plan.seed_of(index);
        seat.order = Order::Reset(seed);
        starts_any = true;
        let slot = &mut seat.slot;
        slot.episode = Some(index);
        slot.generator = Generator::from_seed_and_stream(seed, STREAM_OF_ACTIONS);
        slot.length = 0;
        slot.episode_return = 0.0;
    }
    if starts_any {
        seats.work();
    }
    match seats.iter().find_map(|mut seat| seat.failure.take()) {
        Some(error) => Err(error.into()),
        None => Ok(()),
    }
}

fn step<L: Log>(slot: &mut Slot, log: &mut L) -> Transition {
    log.before_step(slot);
    let transition = slot.env.step(&slot.action, &mut slot.info);
    slot.length += 1;
    slot.episode_return += transition.reward;
    log.after_step(slot, transition);
    transition
}
