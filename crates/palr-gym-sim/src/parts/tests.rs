//! Every part once, whoever calls, however often, whatever panics.

use std::sync::{OnceLock, mpsc};
use std::time::Duration;

use super::*;

struct Counter {
    rounds: usize,
    panics_in: Option<usize>,
}

impl Part for Counter {
    fn work(&mut self) {
        self.rounds += 1;
        assert!(self.panics_in != Some(self.rounds), "asked to panic");
    }
}

fn counters(count: usize, threads: &SimulationThreads) -> Parts<Counter> {
    let parts = (0..count).map(|_| Counter { rounds: 0, panics_in: None }).collect();
    Parts::new(parts, threads.clone())
}

#[test]
fn every_part_is_done_once_a_round_from_inside_and_outside() {
    for (threads, count) in [(1, 1), (1, 7), (2, 1), (3, 2), (4, 64), (3, 1000)] {
        let threads = SimulationThreads::start(threads).unwrap();
        let mut parts = counters(count, &threads);
        for _ in 0..200 {
            parts.work();
        }
        // The same on a simulation thread, which works along.
        let (sender, receiver) = mpsc::channel();
        threads.spawn(move || {
            for _ in 0..200 {
                parts.work();
            }
            sender.send(parts).unwrap();
        });
        let parts = receiver.recv_timeout(Duration::from_secs(60)).unwrap();
        assert!(parts.iter().all(|part| part.rounds == 400));
    }
}

#[test]
fn many_callers_share_the_threads() {
    let threads = SimulationThreads::start(2).unwrap();
    let (sender, receiver) = mpsc::channel();
    for i in 0..32 {
        let (sender, mut parts) = (sender.clone(), counters(i % 5, &threads));
        let rounds = move || {
            for _ in 0..100 {
                parts.work();
            }
            sender.send(parts.iter().all(|part| part.rounds == 100)).unwrap();
        };
        if i % 3 == 0 {
            std::thread::spawn(rounds);
        } else {
            threads.spawn(rounds);
        }
    }
    drop(sender);
    assert_eq!(receiver.iter().collect::<Vec<_>>(), [true; 32]);
}

#[test]
fn a_panic_reaches_the_caller_after_the_other_parts_are_done() {
    let threads = SimulationThreads::start(2).unwrap();
    let mut parts = counters(20, &threads);
    parts.get(3).panics_in = Some(2);
    parts.work();
    let outcome = catch_unwind(AssertUnwindSafe(|| parts.work()));
    assert!(outcome.is_err());
    assert!(parts.iter().all(|part| part.rounds == 2));
    // And the threads, as the parts, are good for more.
    parts.work();
    assert!(parts.iter().all(|part| part.rounds == 3));
}

/// A part whose caller begins the next round before the part's thread has looked for more work.
struct Renewed {
    rounds: usize,
    crew: Arc<OnceLock<Arc<Crew<Renewed>>>>,
}

impl Part for Renewed {
    fn work(&mut self) {
        self.rounds += 1;
        let crew = self.crew.get().expect("set before the work begins");
        if self.rounds < 10 {
            crew.unfinished.fetch_add(1, Ordering::AcqRel);
            for share in &crew.shares {
                share.next.store(share.start, Ordering::Release);
            }
        }
    }
}

#[test]
fn a_quick_caller_does_not_keep_a_thread() {
    let threads = SimulationThreads::start(2).unwrap();
    let crew = Arc::new(OnceLock::new());
    let parts = Parts::new(vec![Renewed { rounds: 0, crew: Arc::clone(&crew) }], threads);
    assert!(crew.set(Arc::clone(&parts.crew)).is_ok());
    for visits in 1..4 {
        // As for a request that a thread has taken.
        parts.crew.unfinished.store(1, Ordering::Release);
        for share in &parts.crew.shares {
            share.next.store(share.start, Ordering::Release);
        }
        parts.crew.work_from(0);
        assert_eq!(parts.get(0).rounds, visits);
    }
}

#[test]
fn who_is_no_simulation_thread_queues_behind_the_others() {
    struct Said(mpsc::Sender<&'static str>, &'static str);
    impl Part for Said {
        fn work(&mut self) {
            self.0.send(self.1).unwrap();
        }
    }
    let threads = SimulationThreads::start(1).unwrap();
    let (release, held) = mpsc::channel::<()>();
    threads.spawn(move || held.recv().unwrap());
    let (sender, order) = mpsc::channel();
    let queued = |count| {
        while threads.queued() < count {
            std::thread::yield_now();
        }
    };
    // The thread holds the first job, or is about to take it.
    while threads.queued() > 0 {
        std::thread::yield_now();
    }
    let mut callers = Vec::new();
    for (count, name) in [(1, "first"), (3, "last")] {
        let mut parts = Parts::new(vec![Said(sender.clone(), name)], threads.clone());
        callers.push(std::thread::spawn(move || parts.work()));
        queued(count);
        if count == 1 {
            let sender = sender.clone();
            threads.spawn(move || sender.send("between").unwrap());
        }
    }
    release.send(()).unwrap();
    for caller in callers {
        caller.join().unwrap();
    }
    drop(sender);
    assert_eq!(order.iter().collect::<Vec<_>>(), ["first", "between", "last"]);
}
