//! The threads on which simulations run.
//!
//! They live as long as the process and take work from one queue. An idle thread looks at the
//! queue for a moment before it sleeps: the next step of a client that is under way arrives sooner
//! than a sleeping thread wakes, while a thousand idle sessions cost nothing. In the steady state
//! nothing here allocates.

use std::cell::Cell;
use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::error::SimError;

/// How long a thread without work looks for some before it sleeps.
const SPIN: Duration = Duration::from_micros(150);
/// Looks at the queue between two glances at the clock, after which other threads get their turn.
const LOOKS: u32 = 64;
/// Room for this many jobs before the queue has to grow.
const QUEUE_ROOM: usize = 256;

/// A thread that is about to end does so within this time, whatever it draws or simulates.
const PATIENCE: Duration = Duration::from_secs(2);

/// Every thread that was started and not waited for.
static STARTED: Mutex<Vec<(Weak<Shared>, JoinHandle<()>)>> = Mutex::new(Vec::new());

/// To be called before the process ends. Graphics libraries clean up at exit, and a thread that uses one
/// meanwhile, be it to free its OpenGL context, crashes: threads that are ending are waited for, and those
/// that end later leave their contexts to the system.
pub fn before_exit() {
    crate::render::leave_contexts();
    let deadline = Instant::now() + PATIENCE;
    let mut started = std::mem::take(&mut *started());
    while !started.is_empty() && Instant::now() < deadline {
        let is_ending = |(shared, thread): &(Weak<Shared>, JoinHandle<()>)| {
            thread.is_finished() || shared.upgrade().is_none_or(|shared| shared.lock().is_closed)
        };
        started.retain(is_ending);
        for index in (0..started.len()).rev() {
            if started[index].1.is_finished() {
                // A panic of a thread was logged when it happened.
                let _ = started.swap_remove(index).1.join();
            }
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn started() -> MutexGuard<'static, Vec<(Weak<Shared>, JoinHandle<()>)>> {
    STARTED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Something to do on a simulation thread.
pub trait Job: Send + Sync + 'static {
    /// Does it. A panic ends the job, not the thread.
    fn run(self: Arc<Self>);
}

/// The threads on which simulations run, shared by all sessions of a process. Clones share them.
#[derive(Clone)]
pub struct SimulationThreads {
    shared: Arc<Shared>,
    _close: Arc<CloseOnDrop>,
}

impl std::fmt::Debug for SimulationThreads {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("SimulationThreads").field("count", &self.count()).finish()
    }
}

struct Shared {
    count: usize,
    queue: Mutex<Queue>,
    /// Jobs in the queue, for a look without the lock.
    queued: AtomicUsize,
    wake: Condvar,
}

struct Queue {
    jobs: VecDeque<Arc<dyn Job>>,
    sleeping: usize,
    is_closed: bool,
}

/// Lets the threads end once nobody can give them work.
struct CloseOnDrop(Arc<Shared>);

impl Drop for CloseOnDrop {
    fn drop(&mut self) {
        self.0.lock().is_closed = true;
        self.0.wake.notify_all();
    }
}

thread_local! {
    /// On a simulation thread: which threads it belongs to, and its index among them.
    static PLACE: Cell<Option<(*const (), usize)>> = const { Cell::new(None) };
}

impl SimulationThreads {
    /// Starts `threads` of them, at least one.
    ///
    /// # Errors
    /// [`SimError::Threads`] if the system refuses.
    pub fn start(threads: usize) -> Result<Self, SimError> {
        let count = threads.max(1);
        let shared = Arc::new(Shared {
            count,
            queue: Mutex::new(Queue {
                jobs: VecDeque::with_capacity(QUEUE_ROOM),
                sleeping: 0,
                is_closed: false,
            }),
            queued: AtomicUsize::new(0),
            wake: Condvar::new(),
        });
        // Dropped on the way out if a thread does not start: those that did then end.
        let close = Arc::new(CloseOnDrop(Arc::clone(&shared)));
        for index in 0..count {
            let worker = Arc::clone(&shared);
            let thread = std::thread::Builder::new()
                .name(format!("sim-{index}"))
                .spawn(move || worker.work(index))
                .map_err(|error| SimError::Threads { threads, message: error.to_string() })?;
            let mut started = started();
            started.retain(|(_, thread)| !thread.is_finished());
            started.push((Arc::downgrade(&shared), thread));
        }
        Ok(Self { shared, _close: close })
    }

    /// How many there are.
    #[must_use]
    pub fn count(&self) -> usize {
        self.shared.count
    }

    /// Queues `job` and returns at once. Jobs begin in the order in which they were queued, parts of
    /// one that has begun before them.
    pub fn submit(&self, job: Arc<dyn Job>) {
        self.shared.push(|jobs| {
            jobs.push_back(job);
            1
        });
    }

    /// Queues a closure and returns at once.
    pub fn spawn(&self, job: impl FnOnce() + Send + 'static) {
        self.submit(Arc::new(Once(Mutex::new(Some(job)))));
    }

    /// Queues `help`, `count` times. Asked by one of these threads, before everything else: what has
    /// begun is finished first. Asked by another, behind it: those could ask without end, and nobody
    /// else would have a turn.
    pub(crate) fn ask_for_help(&self, help: &Arc<dyn Job>, count: usize) {
        if count > 0 {
            let has_begun = self.own_index().is_some();
            self.shared.push(|jobs| {
                for _ in 0..count {
                    match has_begun {
                        true => jobs.push_front(Arc::clone(help)),
                        false => jobs.push_back(Arc::clone(help)),
                    }
                }
                count
            });
        }
    }

    /// Jobs that no thread has taken yet.
    #[cfg(test)]
    pub(crate) fn queued(&self) -> usize {
        self.shared.lock().jobs.len()
    }

    /// The index of the calling thread, if it is one of these.
    pub(crate) fn own_index(&self) -> Option<usize> {
        let here = Arc::as_ptr(&self.shared).cast::<()>();
        PLACE.get().filter(|(threads, _)| *threads == here).map(|(_, index)| index)
    }
}

/// The index of the calling thread among the simulation threads; 0 elsewhere.
pub(crate) fn thread_index() -> usize {
    PLACE.get().map_or(0, |(_, index)| index)
}

/// A closure as a job.
struct Once<F>(Mutex<Option<F>>);

impl<F: FnOnce() + Send + 'static> Job for Once<F> {
    fn run(self: Arc<Self>) {
        let job = lock(&self.0).take();
        if let Some(job) = job {
            job();
        }
    }
}

impl Shared {
    /// Changes the queue by `add`, which returns how many jobs it added, and wakes as many threads.
    fn push(&self, add: impl FnOnce(&mut VecDeque<Arc<dyn Job>>) -> usize) {
        let mut queue = self.lock();
        let added = add(&mut queue.jobs);
        self.queued.fetch_add(added, Ordering::Release);
        let to_wake = added.min(queue.sleeping);
        drop(queue);
        for _ in 0..to_wake {
            self.wake.notify_one();
        }
    }

    fn work(self: Arc<Self>, index: usize) {
        PLACE.set(Some((Arc::as_ptr(&self).cast(), index)));
        while let Some(job) = self.next() {
            // Whoever waits for the job has his own way to learn of its panic; the thread goes on.
            let _ = catch_unwind(AssertUnwindSafe(|| job.run()));
        }
    }

    /// The next job; `None` once there will be no more.
    fn next(&self) -> Option<Arc<dyn Job>> {
        let begin = Instant::now();
        while begin.elapsed() < SPIN {
            for _ in 0..LOOKS {
                if self.queued.load(Ordering::Acquire) > 0
                    && let Some(job) = self.take(&mut self.lock())
                {
                    return Some(job);
                }
                std::hint::spin_loop();
            }
            std::thread::yield_now();
        }
        let mut queue = self.lock();
        loop {
            if let Some(job) = self.take(&mut queue) {
                return Some(job);
            }
            if queue.is_closed {
                return None;
            }
            queue.sleeping += 1;
            queue = self.wake.wait(queue).unwrap_or_else(PoisonError::into_inner);
            queue.sleeping -= 1;
        }
    }

    fn take(&self, queue: &mut Queue) -> Option<Arc<dyn Job>> {
        let job = queue.jobs.pop_front()?;
        self.queued.fetch_sub(1, Ordering::Release);
        Some(job)
    }

    fn lock(&self) -> MutexGuard<'_, Queue> {
        lock(&self.queue)
    }
}

/// A poisoned lock only says that a panic passed; those who share the data have been told.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests;
