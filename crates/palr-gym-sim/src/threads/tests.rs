//! Order, sleep, and an end.

use std::sync::mpsc;

use super::*;

#[test]
fn jobs_of_one_thread_run_in_order_and_a_panic_ends_only_its_job() {
    let threads = SimulationThreads::start(1).unwrap();
    let (sender, receiver) = mpsc::channel();
    for i in 0..100 {
        let sender = sender.clone();
        threads.spawn(move || {
            assert!(i != 50, "asked to panic");
            sender.send(i).unwrap();
        });
    }
    drop(sender);
    let expected: Vec<i32> = (0..100).filter(|i| *i != 50).collect();
    assert_eq!(receiver.iter().collect::<Vec<_>>(), expected);
}

#[test]
fn sleeping_threads_wake_for_every_job() {
    let threads = SimulationThreads::start(3).unwrap();
    let (sender, receiver) = mpsc::channel();
    for i in 0..200 {
        while i % 10 == 0 && threads.shared.lock().sleeping < 3 {
            std::thread::yield_now();
        }
        let sender = sender.clone();
        threads.spawn(move || sender.send(i).unwrap());
    }
    drop(sender);
    let mut got: Vec<i32> = receiver.iter().collect();
    got.sort_unstable();
    assert_eq!(got, (0..200).collect::<Vec<_>>());
}

#[test]
fn threads_end_when_nobody_can_give_them_work() {
    let threads = SimulationThreads::start(2).unwrap();
    let shared = Arc::downgrade(&threads.shared);
    // What is queued is still done.
    let (sender, receiver) = mpsc::channel();
    threads.spawn(move || sender.send(7).unwrap());
    drop(threads);
    assert_eq!(receiver.recv(), Ok(7));
    while shared.strong_count() > 0 {
        std::thread::yield_now();
    }
}

#[test]
fn a_thread_knows_whose_it_is() {
    let ours = SimulationThreads::start(2).unwrap();
    let others = SimulationThreads::start(2).unwrap();
    assert_eq!(ours.own_index(), None);
    let (sender, receiver) = mpsc::channel();
    let asked = ours.clone();
    ours.spawn(move || sender.send((asked.own_index(), others.own_index())).unwrap());
    let (here, elsewhere) = receiver.recv().unwrap();
    assert!(here.is_some_and(|index| index < 2));
    assert_eq!(elsewhere, None);
}
