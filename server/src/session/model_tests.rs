//! The session against a model that is too simple to be wrong: the list of what succeeded so far,
//! replayed on single environments whenever something is asked.

use std::sync::Arc;

use palr_gym_core::{AutoresetMode, OutOfBounds};
use palr_gym_sim::render::GlChoice;
use palr_gym_sim::{Env, SimulationThreads, resolve};
use proptest::prelude::*;

use super::*;
use crate::config::Limits;
use crate::sessions::Sessions;
use crate::vision::Vision;

/// Of a server whose environments show states only.
fn vision() -> Arc<Vision> {
    Arc::new(Vision::new(GlChoice::None, None))
}

const ENV_ID: &str = "hopper-w2";
const ACTION_SIZE: usize = 3;

/// What is asked of a session, wrong requests included.
#[derive(Debug, Clone)]
enum Op {
    Reset {
        seeds: Vec<u64>,
        env_indices: Vec<usize>,
    },
    /// The same `entries` in every row of every step.
    Steps {
        entries: [f32; ACTION_SIZE],
        steps: usize,
        open_loop: bool,
    },
    /// One number too many.
    Misshapen,
    Snapshot,
    /// The snapshot with this index, of those there are.
    Restore(usize),
    /// A snapshot with a changed byte.
    Damaged(usize),
    Close,
}

/// Why a request is refused.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Refusal {
    NeverReset,
    ResetNeeded,
    Action,
    Seeds,
    Indices,
    Snapshot,
    Closed,
}

fn refusal(error: &ServerError) -> Refusal {
    match error {
        ServerError::Sim(SimError::NeverReset) => Refusal::NeverReset,
        ServerError::Sim(SimError::ResetNeeded { .. }) => Refusal::ResetNeeded,
        ServerError::Sim(
            SimError::ActionCount { .. }
            | SimError::ActionNan { .. }
            | SimError::ActionOutOfBounds { .. },
        ) => Refusal::Action,
        ServerError::Sim(SimError::SeedCount { .. }) => Refusal::Seeds,
        ServerError::Sim(SimError::EnvIndex { .. }) => Refusal::Indices,
        ServerError::Sim(SimError::Snapshot(_)) => Refusal::Snapshot,
        ServerError::SessionNotFound { .. } => Refusal::Closed,
        error => panic!("{error}"),
    }
}

/// What a request returns, as far as both sides know it.
#[derive(Debug, Clone, PartialEq, Default)]
struct Seen {
    observations: Vec<f64>,
    rewards: Vec<f64>,
    terminated: Vec<bool>,
    snapshot: Vec<u8>,
}

/// Answers with what the model can know.
struct Plain;

impl Encode for Plain {
    type Answer = Seen;

    fn reset(&self, _: &EnvSpec, standing: &Standing) -> Seen {
        Seen { observations: standing.observations.clone(), ..Seen::default() }
    }

    fn step(&self, _: &EnvSpec, frame: &StepFrame, _: &mut BytesMut) -> Seen {
        Seen {
            observations: frame.observations.clone(),
            rewards: frame.rewards.clone(),
            terminated: frame.terminated.clone(),
            ..Seen::default()
        }
    }

    fn open_loop(&self, spec: &EnvSpec, frame: &StepFrame) -> Seen {
        self.step(spec, frame, &mut BytesMut::new())
    }

    fn pictures(&self, _: Pictures) -> Seen {
        Seen::default()
    }

    fn tag(&self) -> u8 {
        9
    }

    fn snapshot(&self, snapshot: Vec<u8>) -> Seen {
        Seen { snapshot, ..Seen::default() }
    }

    fn restored(&self, spec: &EnvSpec, _: VectorOptions, standing: &Standing) -> Seen {
        self.reset(spec, standing)
    }
}

struct Place {
    env: Env,
    is_over: bool,
}

/// Where the model's environments stand after a replay.
struct State {
    mode: AutoresetMode,
    was_reset: bool,
    places: Vec<Place>,
}

impl State {
    fn after(history: &[Op], num_envs: usize, mode: AutoresetMode) -> Self {
        let places = (0..num_envs)
            .map(|_| {
                let (task, spec) = resolve(ENV_ID).unwrap();
                Place { env: Env::new(task, &Arc::new(spec)).unwrap(), is_over: false }
            })
            .collect();
        let mut state = Self { mode, was_reset: false, places };
        for op in history {
            state.apply(op).unwrap();
        }
        state
    }

    fn observations(&self) -> Vec<f64> {
        self.places.iter().flat_map(|place| place.env.observation().to_vec()).collect()
    }

    /// Resets and steps; the rest is history's business.
    fn apply(&mut self, op: &Op) -> Result<Seen, Refusal> {
        let num_envs = self.places.len();
        let mut seen = Seen::default();
        match op {
            Op::Reset { seeds, env_indices } => {
                if ![0, 1, num_envs].contains(&seeds.len()) {
                    return Err(Refusal::Seeds);
                }
                let is_ascending = env_indices.is_sorted_by(|a, b| a < b);
                if !is_ascending || env_indices.iter().any(|&index| index >= num_envs) {
                    return Err(Refusal::Indices);
                }
                for (i, place) in self.places.iter_mut().enumerate() {
                    if !self.was_reset || env_indices.is_empty() || env_indices.contains(&i) {
                        let seed = match seeds.len() {
                            0 => None,
                            1 => Some(seeds[0] + i as u64),
                            _ => Some(seeds[i]),
                        };
                        place.env.reset(seed).unwrap();
                        place.is_over = false;
                    }
                }
                self.was_reset = true;
                seen.observations = self.observations();
            }
            Op::Steps { entries, steps, .. } => {
                if !self.was_reset {
                    return Err(Refusal::NeverReset);
                }
                if !entries.iter().all(|entry| entry.abs() <= 1.0) {
                    return Err(Refusal::Action);
                }
                let waits = |place: &Place| place.is_over;
                if self.mode == AutoresetMode::Disabled && self.places.iter().any(waits) {
                    return Err(Refusal::ResetNeeded);
                }
                for _ in 0..*steps {
                    for place in &mut self.places {
                        let (reward, terminated) = place.step(entries, self.mode);
                        seen.rewards.push(reward);
                        seen.terminated.push(terminated);
                    }
                    seen.observations.extend(self.observations());
                    if self.mode == AutoresetMode::Disabled && self.places.iter().any(waits) {
                        break;
                    }
                }
            }
            Op::Misshapen => return Err(Refusal::Action),
            Op::Snapshot | Op::Restore(_) | Op::Damaged(_) | Op::Close => {}
        }
        Ok(seen)
    }
}

impl Place {
    fn step(&mut self, entries: &[f32], mode: AutoresetMode) -> (f64, bool) {
        if self.is_over {
            self.env.reset(None).unwrap();
            self.is_over = false;
            return (0.0, false);
        }
        let transition = self.env.step(entries, &mut [0.0; 2]);
        self.is_over = transition.is_last();
        if self.is_over && mode == AutoresetMode::SameStep {
            self.env.reset(None).unwrap();
            self.is_over = false;
        }
        (transition.reward, transition.terminated)
    }
}

fn ops() -> impl Strategy<Value = Vec<Op>> {
    let good = prop_oneof![Just([1.0, -1.0, 1.0]), Just([0.25, 0.5, -0.125]), Just([0.0; 3])];
    let bad = prop_oneof![Just([0.0, f32::NAN, 0.0]), Just([0.0, 0.0, 1.0625])];
    let entries = prop_oneof![9 => good, 1 => bad];
    let op = prop_oneof![
        3 => (prop::collection::vec(0..9u64, 0..4), prop::collection::vec(0..4usize, 0..3))
            .prop_map(|(seeds, env_indices)| Op::Reset { seeds, env_indices }),
        4 => (entries, 1..26usize, any::<bool>()).prop_map(|(entries, steps, open_loop)| {
            Op::Steps { entries, steps: if open_loop { steps } else { 1 }, open_loop }
        }),
        1 => Just(Op::Misshapen),
        2 => Just(Op::Snapshot),
        2 => any::<usize>().prop_map(Op::Restore),
        1 => any::<usize>().prop_map(Op::Damaged),
    ];
    // Closed at the end, and asked for more.
    (prop::collection::vec(op.clone(), 1..14), prop::collection::vec(op, 0..3)).prop_map(
        |(mut ops, late)| {
            ops.insert(0, Op::Reset { seeds: vec![3], env_indices: vec![] });
            ops.push(Op::Close);
            ops.extend(late);
            ops
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn a_session_does_what_the_model_does(
        num_envs in 1..4usize, mode in 0..3usize, skips_first_reset in prop::bool::weighted(0.1),
        ops in ops(),
    ) {
        let mode =
            [AutoresetMode::NextStep, AutoresetMode::SameStep, AutoresetMode::Disabled][mode];
        let options = VectorOptions { autoreset_mode: mode, out_of_bounds: OutOfBounds::Reject };
        let threads = SimulationThreads::start(2).unwrap();
        let sessions = Sessions::new(Limits::default(), threads, vision());
        let id = sessions.open(ENV_ID, None, num_envs as u64, options, Plain).unwrap().id().to_string();
        let mut history: Vec<Op> = Vec::new();
        let mut snapshots: Vec<(Vec<Op>, Vec<u8>)> = Vec::new();
        let mut is_closed = false;
        for op in ops.into_iter().skip(usize::from(skips_first_reset)) {
            let mut state = State::after(&history, num_envs, mode);
            let is_unseeded = matches!(&op, Op::Reset { seeds, .. } if seeds.is_empty());
            if is_unseeded && !state.was_reset {
                // The system seeds; nobody knows how.
                continue;
            }
            let chosen = |index: usize| (!snapshots.is_empty()).then(|| index % snapshots.len());
            let count = num_envs * ACTION_SIZE;
            let command = match &op {
                Op::Reset { seeds, env_indices } => Some(Command::Reset {
                    seeds: seeds.clone(),
                    env_indices: env_indices.clone(),
                }),
                Op::Steps { entries, steps, open_loop } => {
                    let actions = entries.repeat(num_envs * steps);
                    Some(match open_loop {
                        true => Command::OpenLoop { actions, steps: *steps },
                        false => Command::Step { actions },
                    })
                }
                Op::Misshapen => Some(Command::Step { actions: vec![0.0; count + 1] }),
                Op::Snapshot => Some(Command::Snapshot),
                Op::Restore(index) => chosen(*index).map(|index| {
                    Command::Restore { snapshot: snapshots[index].1.clone().into() }
                }),
                Op::Damaged(index) => chosen(*index).map(|at| {
                    let mut bytes = snapshots[at].1.clone();
                    let place = index % bytes.len();
                    bytes[place] ^= 0x40;
                    Command::Restore { snapshot: bytes.into() }
                }),
                Op::Close => {
                    prop_assert_eq!(sessions.close(&id).is_err(), is_closed);
                    is_closed = true;
                    continue;
                }
            };
            let Some(command) = command else { continue };
            let got = match sessions.get(&id).map(|session| session.submit(command)) {
                Ok(promise) => promise.unwrap().blocking_recv().unwrap(),
                Err(error) => Err(error),
            };
            let got = got.map_err(|error| refusal(&error));
            if is_closed {
                prop_assert_eq!(got, Err(Refusal::Closed));
                continue;
            }
            let expected = match &op {
                Op::Snapshot => {
                    let seen = got.clone();
                    let snapshot = seen.map(|seen| seen.snapshot).unwrap_or_default();
                    snapshots.push((history.clone(), snapshot.clone()));
                    Ok(Seen { snapshot, ..Seen::default() })
                }
                Op::Restore(index) => {
                    let index = index % snapshots.len();
                    history.clone_from(&snapshots[index].0);
                    state = State::after(&history, num_envs, mode);
                    Ok(Seen { observations: state.observations(), ..Seen::default() })
                }
                Op::Damaged(_) => Err(Refusal::Snapshot),
                op => {
                    let expected = state.apply(op);
                    if expected.is_ok() {
                        history.push(op.clone());
                    }
                    expected
                }
            };
            prop_assert_eq!(got, expected, "{:?} after {:?}", op, history);
        }
    }
}

/// Sessions that are stepped at the same time do not see each other.
#[test]
fn sessions_side_by_side_do_what_each_does_alone() {
    let options = VectorOptions::default();
    let threads = SimulationThreads::start(3).unwrap();
    let sessions = Arc::new(Sessions::new(Limits::default(), threads, vision()));
    let play = move |sessions: &Sessions<Plain>, seed: u64| {
        let session = sessions.open(ENV_ID, None, 5, options, Plain).unwrap();
        let ask = |command| session.submit(command).unwrap().blocking_recv().unwrap().unwrap();
        let mut seen = vec![ask(Command::Reset { seeds: vec![seed], env_indices: vec![] })];
        for step in 0..60 {
            let entry = ((step * 7 + seed as usize) % 21) as f32 / 10.0 - 1.0;
            seen.push(ask(Command::Step { actions: vec![entry; 15] }));
        }
        seen
    };
    let alone: Vec<_> = (0..6).map(|seed| play(&sessions, seed)).collect();
    let together: Vec<_> = (0..6)
        .map(|seed| {
            let sessions = Arc::clone(&sessions);
            std::thread::spawn(move || play(&sessions, seed))
        })
        .collect();
    let together: Vec<_> = together.into_iter().map(|thread| thread.join().unwrap()).collect();
    assert!(alone == together);
}
