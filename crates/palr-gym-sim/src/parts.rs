//! Work in parts that the simulation threads share among themselves.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::Thread;

use crate::threads::{Job, SimulationThreads, lock, thread_index};

/// How often a caller that worked along looks whether the last part is done before it sleeps. Others
/// sleep at once: the simulation threads need the cores.
const LOOKS: u32 = 500;

/// One part of a piece of work, with the data that belongs to it.
pub trait Part: Send + 'static {
    /// Does the part's work.
    fn work(&mut self);
}

/// Parts that are worked on together, again and again.
///
/// Each thread begins with a share of its own, the same each time, so that data stays in that
/// core's cache; who has finished helps the others. Which thread does a part changes nothing about
/// its result. Nothing allocates after [`Parts::new`].
pub struct Parts<P: Part> {
    crew: Arc<Crew<P>>,
    /// The same, as what the threads take from their queue.
    help: Arc<dyn Job>,
    threads: SimulationThreads,
}

struct Crew<P> {
    parts: Box<[Mutex<P>]>,
    shares: Box<[Share]>,
    unfinished: AtomicUsize,
    /// Requests for help that no thread has taken yet.
    requests: AtomicUsize,
    caller: Mutex<Option<Thread>>,
    panic: Mutex<Option<Box<dyn Any + Send>>>,
}

/// A range of parts, on a cache line of its own.
#[repr(align(128))]
struct Share {
    start: usize,
    end: usize,
    next: AtomicUsize,
}

impl<P: Part> Parts<P> {
    /// Parts for `threads` to work on.
    #[must_use]
    pub fn new(parts: Vec<P>, threads: SimulationThreads) -> Self {
        let (count, shares) = (parts.len(), threads.count());
        let crew = Arc::new(Crew {
            parts: parts.into_iter().map(Mutex::new).collect(),
            shares: (0..shares)
                .map(|i| Share {
                    start: i * count / shares,
                    end: (i + 1) * count / shares,
                    // Nothing to do yet.
                    next: AtomicUsize::new(count),
                })
                .collect(),
            unfinished: AtomicUsize::new(0),
            requests: AtomicUsize::new(0),
            caller: Mutex::new(None),
            panic: Mutex::new(None),
        });
        Self { help: Arc::clone(&crew) as Arc<dyn Job>, crew, threads }
    }

    /// Number of parts.
    #[must_use]
    pub fn len(&self) -> usize {
        self.crew.parts.len()
    }

    /// True without parts.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.crew.parts.is_empty()
    }

    /// One part. Nobody works on it while there is no [`work`](Self::work) going on.
    ///
    /// # Panics
    /// If there are fewer than `index + 1` parts.
    pub fn get(&self, index: usize) -> MutexGuard<'_, P> {
        lock(&self.crew.parts[index])
    }

    /// All parts, in order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = MutexGuard<'_, P>> {
        self.crew.parts.iter().map(lock)
    }

    /// Does the work of every part, and returns when all are done.
    ///
    /// On a simulation thread the caller works along; elsewhere it only waits, so that no more
    /// than the stated number of threads simulate.
    ///
    /// # Panics
    /// If the work of a part did; the other parts are done nevertheless.
    pub fn work(&mut self) {
        let crew = &*self.crew;
        let count = crew.parts.len();
        let own_index = self.threads.own_index();
        *lock(&crew.caller) = Some(std::thread::current());
        crew.unfinished.store(count, Ordering::Release);
        for share in &crew.shares {
            share.next.store(share.start, Ordering::Release);
        }
        let works_along = usize::from(own_index.is_some());
        let helpers = (self.threads.count() - works_along).min(count.saturating_sub(works_along));
        // Requests of the last time that nobody has got to yet serve as well. One operation, so
        // that a thread which takes such a request either comes first, and is not counted, or sees
        // the work above: were it counted and saw nothing, nobody would come and the caller would
        // wait for ever.
        let pending = crew.requests.fetch_max(helpers, Ordering::AcqRel);
        let missing = helpers.saturating_sub(pending);
        self.threads.ask_for_help(&self.help, missing);
        if let Some(index) = own_index {
            crew.work_from(index);
        }
        let mut looks = works_along as u32 * LOOKS;
        while crew.unfinished.load(Ordering::Acquire) != 0 {
            if looks > 0 {
                looks -= 1;
                std::hint::spin_loop();
            } else {
                std::thread::park();
            }
        }
        let panic = lock(&crew.panic).take();
        if let Some(panic) = panic {
            resume_unwind(panic);
        }
    }
}

impl<P: Part> Job for Crew<P> {
    fn run(self: Arc<Self>) {
        self.requests.fetch_sub(1, Ordering::AcqRel);
        self.work_from(thread_index());
    }
}

impl<P: Part> Crew<P> {
    /// Does what nobody else has begun, the share `index` first. A thread that comes late, even
    /// after the end, finds nothing to do or helps with the next round.
    ///
    /// No more than a round has parts: a caller that is quick to begin the next one would keep the
    /// thread for ever, and others would wait as long. Nothing is left undone, because each round
    /// has requests of its own.
    fn work_from(&self, index: usize) {
        let count = self.shares.len();
        let mut left = self.parts.len();
        for share in (0..count).map(|i| &self.shares[(index + i) % count]) {
            while left > 0 && share.next.load(Ordering::Relaxed) < share.end {
                let part = share.next.fetch_add(1, Ordering::AcqRel);
                if part >= share.end {
                    break;
                }
                self.do_part(part);
                left -= 1;
            }
        }
    }

    fn do_part(&self, index: usize) {
        let done = catch_unwind(AssertUnwindSafe(|| lock(&self.parts[index]).work()));
        if let Err(panic) = done {
            *lock(&self.panic) = Some(panic);
        }
        // A caller that sleeps is still there to be woken; if it has seen the end by itself, waking
        // whoever calls now does no harm.
        if self.unfinished.fetch_sub(1, Ordering::AcqRel) == 1 {
            // Not under the lock, which the caller takes when it begins the next round.
            let caller = lock(&self.caller).clone();
            if let Some(caller) = caller
                && caller.id() != std::thread::current().id()
            {
                caller.unpark();
            }
        }
    }
}

#[cfg(test)]
mod tests;
