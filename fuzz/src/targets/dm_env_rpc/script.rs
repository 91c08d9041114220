//! Bytes as requests. Any bytes are a script: what is not understood stands for something else.

use std::collections::BTreeMap;

use palr_gym_proto::dm_env_rpc::v1 as wire;
use palr_gym_proto::dm_env_rpc::v1::environment_request::Payload as Request;
use palr_gym_proto::dm_env_rpc::v1::tensor::{
    DoubleArray, FloatArray, Int64Array, Payload, StringArray,
};

/// A seed among the settings of a request.
#[derive(Debug, Clone, Copy)]
pub(super) enum Seed {
    Unset,
    Value(u64),
    /// Of another type, or another setting altogether.
    Wrong,
}

/// The settings of a world.
#[derive(Debug, Clone, Copy)]
pub(super) enum WorldSettings {
    Plain(Seed),
    RemoteGym(Seed),
    UnknownEnv,
    Empty,
}

impl WorldSettings {
    /// The world's seed. None: they are refused.
    pub(super) fn seed(self) -> Option<Option<u64>> {
        match self {
            Self::Plain(seed) | Self::RemoteGym(seed) => seed.valid(),
            Self::UnknownEnv | Self::Empty => None,
        }
    }
}

/// The action of a step.
#[derive(Debug, Clone, Copy)]
pub(super) enum Action {
    None,
    Whole([f32; 3]),
    Single(f32),
    WrongUid,
    WrongType,
    WrongShape(i32),
}

#[derive(Debug, Clone)]
pub(super) struct Step {
    uids: Vec<u64>,
    action: Action,
}

impl Step {
    pub(super) fn uids_are_valid(&self) -> bool {
        self.uids.iter().all(|uid| (1..=2).contains(uid))
    }

    /// Whether the episode terminates, or is truncated. None: the action is refused.
    pub(super) fn outcome(&self) -> Option<(bool, bool)> {
        let action = match self.action {
            Action::None => [0.0; 3],
            Action::Whole(action) => action,
            Action::Single(entry) => [entry; 3],
            Action::WrongUid | Action::WrongType | Action::WrongShape(_) => return None,
        };
        let is_valid = action.iter().all(|entry| (-1.0..=1.0).contains(entry));
        is_valid.then_some((action[0] > 0.9, action[1] > 0.9))
    }
}

#[derive(Debug, Clone)]
pub(super) enum Command {
    Create {
        settings: WorldSettings,
    },
    Join {
        world: usize,
        seed: Seed,
    },
    Step(Step),
    Reset {
        seed: Seed,
    },
    ResetWorld {
        world: usize,
        seed: Seed,
    },
    Leave,
    Destroy {
        world: usize,
    },
    Extension,
    Nothing,
    /// The stream ends.
    HangUp,
}

/// Commands from bytes.
pub(super) struct Script<'a> {
    rest: &'a [u8],
}

impl<'a> Script<'a> {
    pub(super) fn new(rest: &'a [u8]) -> Self {
        Self { rest }
    }

    /// The next connection, of so many, and what it does.
    pub(super) fn next(&mut self, connections: usize) -> Option<(usize, Command)> {
        let byte = self.byte()?;
        let index = usize::from(byte >> 4) % connections;
        let command = match byte % 16 {
            0 | 1 => Command::Create { settings: self.settings() },
            2 | 3 => Command::Join { world: self.world(), seed: self.seed() },
            4..=8 => Command::Step(self.step()),
            9 => Command::Reset { seed: self.seed() },
            10 => Command::ResetWorld { world: self.world(), seed: self.seed() },
            11 => Command::Leave,
            12 => Command::Destroy { world: self.world() },
            13 => Command::Extension,
            14 => Command::Nothing,
            _ => Command::HangUp,
        };
        Some((index, command))
    }

    fn byte(&mut self) -> Option<u8> {
        let (first, rest) = self.rest.split_first()?;
        self.rest = rest;
        Some(*first)
    }

    /// Zero where the script has ended.
    fn value(&mut self) -> u8 {
        self.byte().unwrap_or(0)
    }

    fn world(&mut self) -> usize {
        usize::from(self.value() % 6)
    }

    fn seed(&mut self) -> Seed {
        match self.value() {
            byte if byte < 128 => Seed::Unset,
            byte if byte < 240 => Seed::Value(u64::from(byte)),
            _ => Seed::Wrong,
        }
    }

    fn settings(&mut self) -> WorldSettings {
        match self.value() % 8 {
            0..=3 => WorldSettings::Plain(self.seed()),
            4 | 5 => WorldSettings::RemoteGym(self.seed()),
            6 => WorldSettings::UnknownEnv,
            _ => WorldSettings::Empty,
        }
    }

    fn step(&mut self) -> Step {
        let count = usize::from(self.value() % 4);
        // Now and then an id that there is not.
        let uids = (0..count).map(|_| 1 + u64::from(self.value() % 9) / 4).collect();
        let action = match self.value() % 8 {
            0 => Action::None,
            1..=3 => Action::Whole([self.entry(), self.entry(), self.entry()]),
            4 => Action::Single(self.entry()),
            5 => Action::WrongUid,
            6 => Action::WrongType,
            _ => Action::WrongShape(i32::from(self.value()) - 128),
        };
        Step { uids, action }
    }

    fn entry(&mut self) -> f32 {
        match self.value() {
            255 => f32::NAN,
            254 => f32::INFINITY,
            // From -1.28 to 1.25.
            byte => (f32::from(byte) - 128.0) / 100.0,
        }
    }
}

impl Command {
    /// The request. `names` are those of the worlds, in the order of their creation.
    pub(super) fn request(&self, names: &[&str]) -> wire::EnvironmentRequest {
        let name = |world: usize| names.get(world).copied().unwrap_or("nowhere").to_owned();
        let payload = match self {
            Self::Create { settings } => {
                let settings = world_settings(*settings);
                Some(Request::CreateWorld(wire::CreateWorldRequest { settings }))
            }
            Self::Join { world, seed } => Some(Request::JoinWorld(wire::JoinWorldRequest {
                world_name: name(*world),
                settings: seed_settings(*seed),
            })),
            Self::Step(step) => Some(Request::Step(wire::StepRequest {
                actions: actions(step.action),
                requested_observations: step.uids.clone(),
            })),
            Self::Reset { seed } => {
                let settings = seed_settings(*seed);
                Some(Request::Reset(wire::ResetRequest { settings }))
            }
            Self::ResetWorld { world, seed } => {
                Some(Request::ResetWorld(wire::ResetWorldRequest {
                    world_name: name(*world),
                    settings: seed_settings(*seed),
                }))
            }
            Self::Leave => Some(Request::LeaveWorld(wire::LeaveWorldRequest {})),
            Self::Destroy { world } => {
                let world_name = name(*world);
                Some(Request::DestroyWorld(wire::DestroyWorldRequest { world_name }))
            }
            Self::Extension => Some(Request::Extension(Default::default())),
            Self::Nothing | Self::HangUp => None,
        };
        wire::EnvironmentRequest { payload }
    }
}

fn scalar(payload: Payload) -> wire::Tensor {
    wire::Tensor { payload: Some(payload), shape: vec![] }
}

fn text(text: &str) -> wire::Tensor {
    scalar(Payload::Strings(StringArray { array: vec![text.to_owned()] }))
}

fn seed_settings(seed: Seed) -> BTreeMap<String, wire::Tensor> {
    let tensor = match seed {
        Seed::Unset => return BTreeMap::new(),
        Seed::Value(seed) => scalar(Payload::Int64s(Int64Array { array: vec![seed as i64] })),
        Seed::Wrong => text("zero"),
    };
    BTreeMap::from([("seed".to_owned(), tensor)])
}

fn world_settings(settings: WorldSettings) -> BTreeMap<String, wire::Tensor> {
    let mut tensors = BTreeMap::new();
    match settings {
        WorldSettings::Plain(seed) => {
            tensors = seed_settings(seed);
            tensors.insert("env_id".to_owned(), text("hopper"));
        }
        WorldSettings::RemoteGym(seed) => {
            let seed = match seed {
                Seed::Unset => String::new(),
                Seed::Value(seed) => format!(r#", "seed": {seed}"#),
                Seed::Wrong => r#", "seed": -1"#.to_owned(),
            };
            let args = format!(r#"{{"entrypoint": "hopper"{seed}}}"#);
            tensors.insert("args".to_owned(), text(&args));
        }
        WorldSettings::UnknownEnv => {
            tensors.insert("env_id".to_owned(), text("hoper"));
        }
        WorldSettings::Empty => {}
    }
    tensors
}

fn actions(action: Action) -> BTreeMap<u64, wire::Tensor> {
    let floats = |array: &[f32]| Payload::Floats(FloatArray { array: array.to_vec() });
    let (uid, payload, shape) = match action {
        Action::None => return BTreeMap::new(),
        Action::Whole(action) => (1, floats(&action), vec![3]),
        Action::Single(entry) => (1, floats(&[entry]), vec![-1]),
        Action::WrongUid => (7, floats(&[0.0]), vec![]),
        Action::WrongType => (1, Payload::Doubles(DoubleArray { array: vec![0.0; 3] }), vec![3]),
        // Two elements fit no shape.
        Action::WrongShape(size) => (1, floats(&[0.0; 2]), vec![size, 1]),
    };
    BTreeMap::from([(uid, wire::Tensor { payload: Some(payload), shape })])
}

/// A step, for those who want a message of this protocol.
#[must_use]
pub fn a_step() -> wire::EnvironmentRequest {
    let step = Step { uids: vec![1, 2], action: Action::Whole([0.5, -0.5, 0.0]) };
    Command::Step(step).request(&[])
}

pub(super) fn corpus() -> Vec<Vec<u8>> {
    const CREATE: [u8; 3] = [0, 0, 130];
    const STEP: [u8; 7] = [4, 2, 0, 4, 1, 128, 128];
    let join = |connection: u8| [connection << 4 | 2, 0, 0];
    let step = |connection: u8| {
        let mut bytes = STEP.to_vec();
        bytes[0] |= connection << 4;
        bytes.push(128);
        bytes
    };
    // 220: an entry of 0.92, which ends the episode.
    let last = |first: u8, second: u8| vec![4, 1, 0, 1, first, second, 128];
    let script = |parts: &[Vec<u8>]| parts.concat();
    vec![
        script(&[CREATE.to_vec(), join(0).to_vec(), step(0), step(0), last(220, 128), step(0)]),
        script(&[CREATE.to_vec(), join(0).to_vec(), step(0), last(128, 220), step(0), step(0)]),
        script(&[
            CREATE.to_vec(),
            join(0).to_vec(),
            join(1).to_vec(),
            step(0),
            step(1),
            vec![0x2a, 0, 131],
            step(0),
            step(1),
            step(0),
        ]),
        script(&[
            CREATE.to_vec(),
            join(0).to_vec(),
            step(0),
            vec![9, 140],
            step(0),
            vec![11, 12, 0],
        ]),
        script(&[
            vec![0, 4, 129],
            join(1).to_vec(),
            step(1),
            vec![0x1f],
            join(2).to_vec(),
            step(2),
        ]),
        vec![13, 14, 0, 6, 0, 7, 1, 0, 255],
    ]
}
