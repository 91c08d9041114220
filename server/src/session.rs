//! One session: N environments behind a queue.
//!
//! A session is an actor. Requests are queued by any thread; one simulation thread at a time works
//! the queue off, so environments never need a lock of their own and answers come in the order of
//! requests. Nothing here waits: [`Session::submit`] returns at once with a promise.

use std::collections::VecDeque;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use bytes::{Bytes, BytesMut};
use palr_gym_core::EnvSpec;
use palr_gym_sim::{
    Job as ThreadJob, OpenLoop, SimError, SimulationThreads, Snapshot, StepFrame, VectorEnv,
    VectorOptions,
};
use tokio::sync::oneshot;
use uuid::Uuid;

use crate::error::ServerError;
use crate::pictures::{Drawing, PictureOrder, Pictures};

/// An open loop gives other sessions their turn after this many steps of environments: a fraction of
/// a second.
const OPEN_LOOP_SLICE: usize = 4096;
/// And drawing after this many pixels, or one picture.
const DRAWING_SLICE_PX: usize = 1 << 18;

/// Names a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct SessionId(Uuid);

impl SessionId {
    /// An id that nobody can guess.
    #[must_use]
    pub fn random() -> Self {
        Self(Uuid::new_v4())
    }

    /// The id that `text` spells, if it is one.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        Uuid::try_parse(text).ok().map(Self)
    }
}

impl fmt::Display for SessionId {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(formatter)
    }
}

/// What a client asks of a session.
#[derive(Debug, Clone)]
pub enum Command {
    /// Start new episodes.
    Reset {
        /// None, one, or one for each environment.
        seeds: Vec<u64>,
        /// Which environments; empty means all.
        env_indices: Vec<usize>,
    },
    /// Step every environment.
    Step {
        /// `[num_envs, action_size]`.
        actions: Vec<f32>,
    },
    /// Step every environment several times.
    OpenLoop {
        /// `[steps, num_envs, action_size]`.
        actions: Vec<f32>,
        /// How often.
        steps: usize,
    },
    /// Tell where the environments stand, as after a restore.
    Standing,
    /// Show what environments look like.
    Draw {
        /// Which, and how.
        order: PictureOrder,
    },
    /// Tell the whole state.
    Snapshot,
    /// Take a state up again.
    Restore {
        /// What a snapshot said.
        snapshot: Bytes,
    },
}

/// Where an environment stands after a reset or a restore.
#[derive(Debug, Clone, Default)]
pub struct Standing {
    /// `[num_envs, observation_size]`.
    pub observations: Vec<f64>,
    /// `[num_envs, reset_info_names]`; NaN in rows that were not reset.
    pub reset_info: Vec<f64>,
    /// `[num_envs]`: the episode has ended.
    pub is_over: Vec<bool>,
    /// There was a reset at some time.
    pub was_reset: bool,
}

impl Standing {
    fn look(&mut self, env: &VectorEnv) {
        env.observations_into(&mut self.observations);
        env.reset_info_into(&mut self.reset_info);
        env.is_over_into(&mut self.is_over);
        self.was_reset = env.was_reset();
    }
}

/// What a session answers. Generic over how a frame leaves the simulation thread, so that wire
/// types stay out of here.
pub trait Encode: Send + Sync + 'static {
    /// An answer, ready to be sent.
    type Answer: Send + 'static;

    /// After a reset.
    fn reset(&self, spec: &EnvSpec, standing: &Standing) -> Self::Answer;

    /// After a step. `room` is the session's own, to be used again by the next answer once this one
    /// is gone.
    fn step(&self, spec: &EnvSpec, frame: &StepFrame, room: &mut BytesMut) -> Self::Answer;

    /// After several.
    fn open_loop(&self, spec: &EnvSpec, frame: &StepFrame) -> Self::Answer;

    /// After drawing.
    fn pictures(&self, pictures: Pictures) -> Self::Answer;

    /// What of this encoding a snapshot must keep.
    fn tag(&self) -> u8;

    /// A snapshot.
    fn snapshot(&self, snapshot: Vec<u8>) -> Self::Answer;

    /// After a restore.
    fn restored(&self, spec: &EnvSpec, options: VectorOptions, standing: &Standing)
    -> Self::Answer;
}

/// What will come of a submitted command.
pub type Promise<A> = oneshot::Receiver<Result<A, ServerError>>;

struct Job<A> {
    command: Command,
    reply: oneshot::Sender<Result<A, ServerError>>,
}

/// The queue, and whether a simulation thread is at work on it.
struct Queue<A> {
    jobs: VecDeque<Job<A>>,
    is_scheduled: bool,
    is_broken: bool,
}

/// Environments and the buffers that their steps reuse.
struct Bench {
    env: VectorEnv,
    frame: StepFrame,
    standing: Standing,
    /// Where answers to steps are written.
    room: BytesMut,
    /// Under way, if the first job in the queue is one.
    open_loop: Option<OpenLoop>,
    /// Likewise.
    drawing: Option<Drawing>,
}

/// N environments behind a queue.
pub struct Session<E: Encode> {
    id: SessionId,
    spec: Arc<EnvSpec>,
    num_envs: usize,
    options: VectorOptions,
    snapshot_len: usize,
    encode: E,
    threads: SimulationThreads,
    queue: Mutex<Queue<E::Answer>>,
    bench: Mutex<Bench>,
    opened: Instant,
    /// Milliseconds from `opened` to the last request or answer.
    last_used_ms: AtomicU64,
    max_queued: usize,
}

impl<E: Encode> Session<E> {
    /// A session around `env`.
    pub fn new(env: VectorEnv, encode: E, threads: SimulationThreads, max_queued: usize) -> Self {
        Self {
            id: SessionId::random(),
            spec: Arc::clone(env.spec()),
            num_envs: env.len(),
            options: env.options(),
            snapshot_len: env.snapshot_len(),
            encode,
            threads,
            queue: Mutex::new(Queue {
                jobs: VecDeque::new(),
                is_scheduled: false,
                is_broken: false,
            }),
            bench: Mutex::new(Bench {
                env,
                frame: StepFrame::default(),
                standing: Standing::default(),
                room: BytesMut::new(),
                open_loop: None,
                drawing: None,
            }),
            opened: Instant::now(),
            last_used_ms: AtomicU64::new(0),
            max_queued,
        }
    }

    /// Its name.
    pub fn id(&self) -> SessionId {
        self.id
    }

    /// What its environments are.
    pub fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    /// Number of environments.
    pub fn num_envs(&self) -> usize {
        self.num_envs
    }

    /// How it treats ends and actions.
    pub fn options(&self) -> VectorOptions {
        self.options
    }

    /// How its answers are encoded.
    pub fn encode(&self) -> &E {
        &self.encode
    }

    /// Bytes in a snapshot of it.
    pub fn snapshot_len(&self) -> usize {
        self.snapshot_len
    }

    /// True while a request is queued or worked on.
    pub fn is_at_work(&self) -> bool {
        self.lock_queue().is_scheduled
    }

    /// How long ago it was last used; zero while it has work.
    pub fn idle(&self) -> Duration {
        if self.lock_queue().is_scheduled {
            return Duration::ZERO;
        }
        let last_used = Duration::from_millis(self.last_used_ms.load(Ordering::Relaxed));
        self.opened.elapsed().saturating_sub(last_used)
    }

    /// Queues a command.
    ///
    /// # Errors
    /// [`ServerError::QueueFull`] or [`ServerError::SessionBroken`], at once. What the command
    /// itself leads to comes through the promise.
    pub fn submit(self: &Arc<Self>, command: Command) -> Result<Promise<E::Answer>, ServerError> {
        self.touch();
        let (reply, promise) = oneshot::channel();
        let must_schedule = {
            let mut queue = self.lock_queue();
            if queue.is_broken {
                return Err(ServerError::SessionBroken { id: self.id });
            }
            if queue.jobs.len() >= self.max_queued {
                return Err(ServerError::QueueFull { id: self.id, queued: queue.jobs.len() });
            }
            queue.jobs.push_back(Job { command, reply });
            !std::mem::replace(&mut queue.is_scheduled, true)
        };
        if must_schedule {
            self.schedule();
        }
        Ok(promise)
    }

    fn schedule(self: &Arc<Self>) {
        self.threads.submit(Arc::clone(self) as Arc<dyn ThreadJob>);
    }

    /// Does one job, or a slice of one, then queues itself again behind other sessions' work if more
    /// is waiting.
    fn work(self: &Arc<Self>) {
        let Some(job) = self.lock_queue().jobs.pop_front() else {
            self.lock_queue().is_scheduled = false;
            return;
        };
        // A panic must cost no more than this session.
        let done = catch_unwind(AssertUnwindSafe(|| self.execute(&job.command)))
            .unwrap_or_else(|_| Err(self.break_down()));
        self.touch();
        match done.transpose() {
            // The caller may have gone; then nobody wants the answer.
            Some(answer) => drop(job.reply.send(answer)),
            None => self.lock_queue().jobs.push_front(job),
        }
        let has_more = {
            let mut queue = self.lock_queue();
            queue.is_scheduled = !queue.jobs.is_empty();
            queue.is_scheduled
        };
        if has_more {
            self.schedule();
        }
    }

    /// Does a command, or a part of it: then there is no answer yet, and the rest is still to do.
    fn execute(&self, command: &Command) -> Result<Option<E::Answer>, ServerError> {
        let mut bench = lock(&self.bench);
        let Bench { env, frame, standing, room, open_loop, drawing } = &mut *bench;
        let answer = match command {
            Command::Reset { seeds, env_indices } => {
                env.reset(seeds, env_indices)?;
                standing.look(env);
                self.encode.reset(&self.spec, standing)
            }
            Command::Step { actions } => {
                env.step(actions, frame)?;
                self.encode.step(&self.spec, frame, room)
            }
            Command::OpenLoop { actions, steps } => {
                let mut under_way = match open_loop.take() {
                    Some(under_way) => under_way,
                    None => env.begin_open_loop(actions, *steps, frame)?,
                };
                let slice = OPEN_LOOP_SLICE / self.num_envs;
                if !env.continue_open_loop(actions, &mut under_way, slice, frame) {
                    *open_loop = Some(under_way);
                    return Ok(None);
                }
                let answer = self.encode.open_loop(&self.spec, frame);
                // Room for that many steps is not worth keeping.
                *frame = StepFrame::default();
                env.release_room();
                answer
            }
            Command::Standing => {
                standing.look(env);
                self.encode.restored(&self.spec, self.options, standing)
            }
            Command::Draw { order } => {
                let mut under_way = match drawing.take() {
                    Some(under_way) => under_way,
                    None => order.begin(env)?,
                };
                if !under_way.go_on(order, env, DRAWING_SLICE_PX)? {
                    *drawing = Some(under_way);
                    return Ok(None);
                }
                self.encode.pictures(under_way.pictures(order))
            }
            Command::Snapshot => self.encode.snapshot(env.snapshot(self.encode.tag())),
            Command::Restore { snapshot } => {
                let snapshot = Snapshot::parse(snapshot).map_err(SimError::from)?;
                if snapshot.tag != self.encode.tag() {
                    return Err(ServerError::SnapshotTag);
                }
                env.restore(&snapshot)?;
                standing.look(env);
                self.encode.restored(&self.spec, self.options, standing)
            }
        };
        Ok(Some(answer))
    }

    /// After a panic nobody knows what state the environments are in: no more of them, whoever waits.
    fn break_down(&self) -> ServerError {
        let mut queue = self.lock_queue();
        queue.is_broken = true;
        for job in queue.jobs.drain(..) {
            drop(job.reply.send(Err(ServerError::SessionBroken { id: self.id })));
        }
        ServerError::SessionBroken { id: self.id }
    }

    fn touch(&self) {
        self.last_used_ms.store(self.opened.elapsed().as_millis() as u64, Ordering::Relaxed);
    }

    fn lock_queue(&self) -> MutexGuard<'_, Queue<E::Answer>> {
        lock(&self.queue)
    }
}

impl<E: Encode> ThreadJob for Session<E> {
    fn run(self: Arc<Self>) {
        self.work();
    }
}

/// A poisoned lock only says that a panic passed; `break_down` has dealt with it.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod model_tests;
#[cfg(test)]
mod tests;
