//! Scripts of requests on three connections, held against a model of the protocol.

mod script;
mod stage;

use std::sync::Arc;

use futures_util::FutureExt;
use palr_gym_proto::dm_env_rpc::v1 as wire;
use palr_gym_proto::dm_env_rpc::v1::EnvironmentStateType as State;
use palr_gym_proto::dm_env_rpc::v1::environment_request::Payload as Request;
use palr_gym_proto::dm_env_rpc::v1::environment_response::Payload as Response;
use palr_gym_proto::dm_env_rpc::v1::tensor;
use palr_gym_server::dm_env_rpc::{Connection, Worlds};

pub use script::a_step;
use script::{Script, Seed, Step};
use stage::FakeStage;

const CONNECTIONS: usize = 3;
const MAX_WORLDS: usize = 4;
/// Requests of one script.
const MAX_REQUESTS: usize = 24;

/// What a world is, as far as the protocol says.
struct World {
    name: String,
    seed: Option<u64>,
    resets: u64,
    exists: bool,
}

/// A connection in a world.
struct Seat {
    world: usize,
    env: u64,
    state: State,
    resets: u64,
    next_seed: Option<u64>,
    /// What was shown last: environment, seed, steps.
    shown: [f64; 3],
}

/// What the protocol says should happen.
#[derive(Default)]
struct Model {
    worlds: Vec<World>,
    seats: [Option<Seat>; CONNECTIONS],
    opened: u64,
}

/// What an answer should be: none is an error.
enum Expected {
    Created,
    Joined,
    Stepped(State, [f64; 3]),
    Reset,
    WorldReset,
    Left,
    Destroyed,
}

/// See the module.
pub fn run(data: &[u8]) {
    let worlds = Arc::new(Worlds::new(MAX_WORLDS, std::time::Duration::from_secs(60)));
    let stage = Arc::new(FakeStage::default());
    let connect = || Connection::new(Arc::clone(&stage), Arc::clone(&worlds));
    let mut connections: [Connection<FakeStage>; CONNECTIONS] = std::array::from_fn(|_| connect());
    let mut model = Model::default();
    let mut script = Script::new(data);
    for _ in 0..MAX_REQUESTS {
        let Some((index, command)) = script.next(CONNECTIONS) else { break };
        if matches!(command, script::Command::HangUp) {
            connections[index] = connect();
            model.seats[index] = None;
            continue;
        }
        let names: Vec<&str> = model.worlds.iter().map(|world| world.name.as_str()).collect();
        let request = command.request(&names);
        let expected = model.expect(index, &command);
        let is_resetting = matches!(request.payload, Some(Request::ResetWorld(_)));
        // Nothing of the fake waits.
        let answer = connections[index].answer(request).now_or_never().expect("an answer");
        model.check(expected, answer.map(|answer| answer.payload.expect("a payload")));
        assert!(!is_resetting || model.worlds.len() <= MAX_REQUESTS);
        assert_eq!(worlds.len(), model.worlds.iter().filter(|world| world.exists).count());
        assert_eq!(stage.open(), model.seats.iter().flatten().count());
    }
    drop(connections);
    assert_eq!(stage.open(), 0, "an environment outlived its connection");
}

impl Model {
    fn find(&self, world: usize) -> Option<usize> {
        self.worlds.get(world).filter(|world| world.exists).map(|_| world)
    }

    /// What should come of a command; the model is then where the server should be.
    fn expect(&mut self, index: usize, command: &script::Command) -> Option<Expected> {
        use script::Command;
        match *command {
            Command::Create { ref settings } => {
                let seed = settings.seed()?;
                let exist = self.worlds.iter().filter(|world| world.exists).count();
                (exist < MAX_WORLDS).then(|| {
                    // The name comes with the answer.
                    let name = String::new();
                    self.worlds.push(World { name, seed, resets: 0, exists: true });
                    Expected::Created
                })
            }
            Command::Join { world, seed } => {
                let (world, seed) = (self.find(world)?, seed.valid()?);
                if self.seats[index].is_some() {
                    return None;
                }
                self.opened += 1;
                let World { resets, seed: of_world, .. } = self.worlds[world];
                self.seats[index] = Some(Seat {
                    world,
                    env: self.opened,
                    state: State::Interrupted,
                    resets,
                    next_seed: seed.or(of_world),
                    shown: [0.0; 3],
                });
                Some(Expected::Joined)
            }
            Command::Step(ref step) => self.expect_step(index, step),
            Command::Reset { seed } => {
                let seat = self.seats[index].as_mut()?;
                let seed = seed.valid()?;
                seat.notice(&self.worlds[seat.world]);
                seat.next_seed = seed.or(seat.next_seed);
                seat.interrupt();
                Some(Expected::Reset)
            }
            Command::ResetWorld { world, seed } => {
                let (world, seed) = (self.find(world)?, seed.valid()?);
                let world = &mut self.worlds[world];
                world.resets += 1;
                world.seed = seed.or(world.seed);
                Some(Expected::WorldReset)
            }
            Command::Leave => {
                self.seats[index] = None;
                Some(Expected::Left)
            }
            Command::Destroy { world } => {
                let world = self.find(world)?;
                if self.seats.iter().flatten().any(|seat| seat.world == world) {
                    return None;
                }
                self.worlds[world].exists = false;
                Some(Expected::Destroyed)
            }
            Command::Extension | Command::Nothing | Command::HangUp => None,
        }
    }

    fn expect_step(&mut self, index: usize, step: &Step) -> Option<Expected> {
        let seat = self.seats[index].as_mut()?;
        if !step.uids_are_valid() {
            return None;
        }
        if seat.notice(&self.worlds[seat.world]) && seat.state == State::Running {
            seat.interrupt();
        } else if seat.state == State::Running {
            let (terminated, truncated) = step.outcome()?;
            seat.shown[2] += 1.0;
            seat.state = match (terminated, truncated) {
                (true, _) => State::Terminated,
                (false, true) => State::Interrupted,
                (false, false) => State::Running,
            };
        } else {
            let seed = seat.next_seed.take().map_or(-1.0, |seed| seed as f64);
            seat.shown = [seat.env as f64, seed, 0.0];
            seat.state = State::Running;
        }
        Some(Expected::Stepped(seat.state, seat.shown))
    }

    fn check<E: std::fmt::Debug>(&mut self, expected: Option<Expected>, got: Result<Response, E>) {
        match (expected, got) {
            (None, Err(_))
            | (Some(Expected::Joined), Ok(Response::JoinWorld(_)))
            | (Some(Expected::Reset), Ok(Response::Reset(_)))
            | (Some(Expected::WorldReset), Ok(Response::ResetWorld(_)))
            | (Some(Expected::Left), Ok(Response::LeaveWorld(_)))
            | (Some(Expected::Destroyed), Ok(Response::DestroyWorld(_))) => {}
            (Some(Expected::Created), Ok(Response::CreateWorld(created))) => {
                let is_new = self.worlds.iter().all(|world| world.name != created.world_name);
                assert!(is_new, "two worlds have one name");
                self.worlds.last_mut().expect("the new one").name = created.world_name;
            }
            (Some(Expected::Stepped(state, shown)), Ok(Response::Step(step))) => {
                assert_eq!(step.state(), state);
                if let Some(observation) = step.observations.get(&1) {
                    assert_eq!(first_three(observation), shown, "another's environment, or step");
                }
            }
            (Some(_), Ok(other)) => panic!("an answer of another kind: {other:?}"),
            (Some(_), Err(error)) => panic!("refused without a reason: {error:?}"),
            (None, Ok(other)) => panic!("should have been refused: {other:?}"),
        }
    }
}

impl Seat {
    fn notice(&mut self, world: &World) -> bool {
        let was_reset = self.resets != world.resets;
        if was_reset {
            self.resets = world.resets;
            self.next_seed = world.seed;
        }
        was_reset
    }

    fn interrupt(&mut self) {
        if self.state == State::Running {
            self.state = State::Interrupted;
        }
    }
}

fn first_three(observation: &wire::Tensor) -> [f64; 3] {
    match &observation.payload {
        Some(tensor::Payload::Doubles(doubles)) => {
            [doubles.array[0], doubles.array[1], doubles.array[2]]
        }
        other => panic!("an observation of another type: {other:?}"),
    }
}

/// Scripts that reach every state.
#[must_use]
pub fn corpus() -> Vec<Vec<u8>> {
    script::corpus()
}

/// What a seed of a script stands for.
impl Seed {
    /// None: it is refused.
    fn valid(self) -> Option<Option<u64>> {
        match self {
            Self::Unset => Some(None),
            Self::Value(seed) => Some(Some(seed)),
            Self::Wrong => None,
        }
    }
}
