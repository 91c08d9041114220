//! The loop that both evaluation and collection run.

use std::sync::Arc;

use palr_gym_core::random::Generator;
use palr_gym_core::{EnvSpec, ObservationKind};
use palr_gym_sim::{
    Divergence, Env, Onlooker, Part, Parts, Sight, SimError, SimulationThreads, Task, Transition,
};
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

/// A slot with its log.
pub(super) struct Seat<L> {
    pub(super) slot: Slot,
    log: L,
    order: Order,
    /// What the last step of a playing slot came to.
    transition: Option<Transition>,
    /// Why an episode could not begin.
    failure: Option<SimError>,
}

impl<L: Log> Seat<L> {
    fn new(env: Env, spec: &EnvSpec) -> Self {
        let slot = Slot {
            env,
            episode: None,
            generator: Generator::from_seed(0),
            action: vec![0.0; spec.action_size()],
            action_log_prob: None,
            info: vec![0.0; spec.task.info_names.len()],
            length: 0,
            episode_return: 0.0,
        };
        Self { slot, log: L::default(), order: Order::Rest, transition: None, failure: None }
    }
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

/// Neighbouring seats: what a simulation thread works on at a time, and looks at together.
struct Bench<L> {
    seats: Vec<Seat<L>>,
    onlooker: Onlooker,
}

impl<L: Log> Part for Bench<L> {
    fn work(&mut self) {
        let Self { seats, onlooker } = self;
        for Seat { slot, log, order, transition, failure } in &mut *seats {
            *transition = None;
            match *order {
                Order::Rest => {}
                Order::Reset(seed) => *failure = slot.env.reset(Some(seed)).err(),
                Order::Step => {
                    *transition = slot.is_playing().then(|| {
                        log.before_step(slot);
                        slot.env.step(&slot.action, &mut slot.info)
                    });
                }
            }
        }
        onlooker.see(
            seats,
            |seat| &mut seat.slot.env,
            |_, Seat { slot, transition, failure, .. }, error| {
                if transition.is_none() {
                    *failure = Some(error.clone().into());
                    return;
                }
                slot.info.fill(f64::NAN);
                let divergence = Some(Divergence::Unseen);
                *transition = Some(Transition {
                    reward: 0.0,
                    terminated: false,
                    truncated: true,
                    divergence,
                });
            },
        );
        for Seat { slot, log, transition, .. } in seats {
            if let Some(transition) = *transition {
                slot.length += 1;
                slot.episode_return += transition.reward;
                log.after_step(slot, transition);
            }
        }
    }
}

/// All seats, in benches that the simulation threads share.
pub(super) struct Seats<L: Log> {
    benches: Parts<Bench<L>>,
    len: usize,
}

impl<L: Log> Seats<L> {
    fn new(plan: &Plan) -> Result<Self, SimError> {
        // Only features are better made together; else every seat is a part of its own.
        let leaves_features = matches!(plan.spec.observation, ObservationKind::Features { .. });
        let share =
            if leaves_features { Onlooker::share(plan.num_envs, plan.threads.count()) } else { 1 };
        let mut seats = Vec::with_capacity(plan.num_envs);
        for _ in 0..plan.num_envs {
            let mut env = Env::seeing(plan.task, &plan.spec, &plan.sight)?;
            if leaves_features {
                env.leave_features();
            }
            seats.push(Seat::new(env, &plan.spec));
        }
        let mut benches = Vec::with_capacity(plan.num_envs.div_ceil(share));
        while !seats.is_empty() {
            let rest = seats.split_off(share.min(seats.len()));
            benches.push(Bench { seats, onlooker: Onlooker::default() });
            seats = rest;
        }
        Ok(Self { benches: Parts::new(benches, plan.threads.clone()), len: plan.num_envs })
    }

    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.len
    }

    /// Shows `look` the seats with their indices, in order, until it has found something.
    pub(super) fn find<R>(
        &self,
        mut look: impl FnMut(usize, &mut Seat<L>) -> Option<R>,
    ) -> Option<R> {
        let mut index = 0;
        for mut bench in self.benches.iter() {
            for seat in &mut bench.seats {
                let found = look(index, seat);
                if found.is_some() {
                    return found;
                }
                index += 1;
            }
        }
        None
    }

    /// Shows `look` every slot that is playing, with its index, in order, until one is an error.
    ///
    /// # Errors
    /// That of `look`.
    pub(super) fn try_playing(
        &self,
        mut look: impl FnMut(usize, &mut Slot) -> Result<(), ServerError>,
    ) -> Result<(), ServerError> {
        let failed = self.find(|index, seat| {
            seat.slot.is_playing().then(|| look(index, &mut seat.slot).err()).flatten()
        });
        failed.map_or(Ok(()), Err)
    }

    fn count_playing(&self) -> usize {
        let mut playing = 0;
        self.order(|seat| {
            playing += usize::from(seat.slot.is_playing());
            seat.order
        });
        playing
    }

    /// Gives every seat its order.
    fn order(&self, mut order: impl FnMut(&mut Seat<L>) -> Order) {
        for mut bench in self.benches.iter() {
            for seat in &mut bench.seats {
                seat.order = order(seat);
            }
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
    let mut seats = Seats::<O::Log>::new(plan)?;
    loop {
        if plan.cancelled.is_cancelled() {
            return Err(ServerError::Cancelled);
        }
        start_episodes(plan, &mut seats, observer)?;
        if seats.count_playing() == 0 {
            return Ok(());
        }
        actor.act(&seats)?;
        seats.order(|_| Order::Step);
        seats.benches.work();
        let stopped = seats.find(|_, Seat { slot, log, transition, .. }| {
            let transition = transition.filter(Transition::is_last)?;
            if !observer.ended(slot, transition, std::mem::take(log)) {
                return Some(());
            }
            slot.episode = None;
            None
        });
        if stopped.is_some() {
            return Ok(());
        }
    }
}

fn start_episodes<O: Observer>(
    plan: &Plan,
    seats: &mut Seats<O::Log>,
    observer: &mut O,
) -> Result<(), ServerError> {
    let mut playing = seats.count_playing();
    let (mut starts_any, mut has_more) = (false, true);
    seats.order(|Seat { slot, .. }| {
        if slot.is_playing() || !has_more {
            return Order::Rest;
        }
        let Some(index) = observer.next_episode(playing) else {
            has_more = false;
            return Order::Rest;
        };
        playing += 1;
        starts_any = true;
        let seed = plan.seed_of(index);
        slot.episode = Some(index);
        slot.generator = Generator::from_seed_and_stream(seed, STREAM_OF_ACTIONS);
        slot.length = 0;
        slot.episode_return = 0.0;
        Order::Reset(seed)
    });
    if starts_any {
        seats.benches.work();
    }
    match seats.find(|_, seat| seat.failure.take()) {
        Some(error) => Err(error.into()),
        None => Ok(()),
    }
}
