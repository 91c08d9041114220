//! The actor's promises: order, isolation, limits.

use palr_gym_sim::{VectorOptions, resolve};

use super::*;

/// Answers with what happened, as text, and panics on request.
struct Spy {
    panics: bool,
}

impl Encode for Spy {
    type Answer = &'static str;

    fn reset(&self, _: &EnvSpec, _: &Standing) -> Self::Answer {
        "reset"
    }

    fn step(&self, _: &EnvSpec, _: &StepFrame, _: &mut BytesMut) -> Self::Answer {
        assert!(!self.panics, "asked to panic");
        "step"
    }

    fn open_loop(&self, _: &EnvSpec, _: &StepFrame) -> Self::Answer {
        "open loop"
    }

    fn pictures(&self, _: Pictures) -> Self::Answer {
        "pictures"
    }

    fn tag(&self) -> u8 {
        0
    }

    fn snapshot(&self, _: Vec<u8>) -> Self::Answer {
        "snapshot"
    }

    fn restored(&self, _: &EnvSpec, _: VectorOptions, _: &Standing) -> Self::Answer {
        "restored"
    }
}

fn session(panics: bool, max_queued: usize) -> Arc<Session<Spy>> {
    let threads = SimulationThreads::start(1).unwrap();
    let (task, spec) = resolve("hopper").unwrap();
    let env = VectorEnv::new(task, spec, 1, VectorOptions::default(), threads.clone()).unwrap();
    Arc::new(Session::new(env, Spy { panics }, threads, max_queued))
}

/// Keeps the only simulation thread busy until it is dropped.
fn hold_thread(session: &Session<Spy>) -> std::sync::mpsc::Sender<()> {
    let (release, blocked) = std::sync::mpsc::channel::<()>();
    session.threads.spawn(move || {
        let _ = blocked.recv();
    });
    release
}

fn reset() -> Command {
    Command::Reset { seeds: vec![1], env_indices: vec![] }
}

fn step() -> Command {
    Command::Step { actions: vec![0.0; 3] }
}

#[test]
fn answers_come_in_the_order_of_requests_and_errors_spoil_nothing() {
    let session = session(false, 16);
    let bad = Command::Step { actions: vec![f32::NAN; 3] };
    let promises = [reset(), step(), bad, step()].map(|command| session.submit(command).unwrap());
    let answers = promises.map(|promise| promise.blocking_recv().unwrap());
    assert_eq!(answers[0].as_ref().unwrap(), &"reset");
    assert_eq!(answers[1].as_ref().unwrap(), &"step");
    assert!(answers[2].as_ref().unwrap_err().to_string().contains("NaN"));
    assert_eq!(answers[3].as_ref().unwrap(), &"step");
}

#[test]
fn a_panic_breaks_its_session_and_no_thread() {
    let broken = session(true, 16);
    broken.submit(reset()).unwrap().blocking_recv().unwrap().unwrap();
    let error = broken.submit(step()).unwrap().blocking_recv().unwrap().unwrap_err();
    assert!(matches!(error, ServerError::SessionBroken { .. }));
    assert!(matches!(broken.submit(step()), Err(ServerError::SessionBroken { .. })));
    // Nor is what was queued behind it answered from such a state.
    let broken = session(true, 16);
    let hold = hold_thread(&broken);
    let promises = [reset(), step(), reset()].map(|command| broken.submit(command).unwrap());
    drop(hold);
    let [first, second, third] = promises.map(|promise| promise.blocking_recv().unwrap());
    first.unwrap();
    for answer in [second, third] {
        assert!(matches!(answer, Err(ServerError::SessionBroken { .. })), "{answer:?}");
    }
    // The simulation thread is alive.
    let (sender, receiver) = std::sync::mpsc::channel();
    broken.threads.spawn(move || sender.send(7).unwrap());
    assert_eq!(receiver.recv(), Ok(7));
}

#[test]
fn a_flood_of_requests_is_refused_beyond_the_queue() {
    let session = session(false, 4);
    // The only simulation thread is kept busy until the queue has been overfilled.
    let hold = hold_thread(&session);
    let promises: Vec<_> = (0..4).map(|_| session.submit(reset()).unwrap()).collect();
    let error = session.submit(reset()).unwrap_err();
    assert!(matches!(error, ServerError::QueueFull { queued: 4, .. }), "{error}");
    drop(hold);
    for promise in promises {
        promise.blocking_recv().unwrap().unwrap();
    }
    session.submit(step()).unwrap().blocking_recv().unwrap().unwrap();
}

#[test]
fn a_long_open_loop_lets_other_sessions_have_their_turn() {
    let long = session(false, 16);
    let other = {
        let (task, spec) = resolve("hopper").unwrap();
        let (options, threads) = (VectorOptions::default(), long.threads.clone());
        let env = VectorEnv::new(task, spec, 1, options, threads.clone()).unwrap();
        Arc::new(Session::new(env, Spy { panics: false }, threads, 16))
    };
    let hold = hold_thread(&long);
    let steps = 6 * OPEN_LOOP_SLICE;
    long.submit(reset()).unwrap();
    let mut slow = long.submit(Command::OpenLoop { actions: vec![0.0; 3 * steps], steps }).unwrap();
    let then = long.submit(step()).unwrap();
    let quick = [reset(), step()].map(|command| other.submit(command).unwrap());
    drop(hold);
    for promise in quick {
        promise.blocking_recv().unwrap().unwrap();
    }
    assert!(slow.try_recv().is_err(), "the open loop was one piece");
    assert_eq!(slow.blocking_recv().unwrap().unwrap(), "open loop");
    assert_eq!(then.blocking_recv().unwrap().unwrap(), "step");
}
