//! What the protocol's own compliance suite (tests/python/test_dm_env_rpc.py) does not ask for:
//! several connections, and their ends.

use std::collections::BTreeMap;

use palr_gym_proto::dm_env_rpc::v1 as wire;
use palr_gym_proto::dm_env_rpc::v1::EnvironmentStateType as State;
use palr_gym_proto::dm_env_rpc::v1::environment_client::EnvironmentClient;
use palr_gym_proto::dm_env_rpc::v1::environment_request::Payload as Request;
use palr_gym_proto::dm_env_rpc::v1::environment_response::Payload as Response;
use palr_gym_proto::dm_env_rpc::v1::tensor;
use palr_gym_server::ServerConfig;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::Channel;
use tonic::{Code, Streaming};

use crate::support::{TestServer, soon};

struct Connection {
    requests: mpsc::Sender<wire::EnvironmentRequest>,
    answers: Streaming<wire::EnvironmentResponse>,
}

impl Connection {
    async fn open(channel: Channel) -> Self {
        let (requests, outgoing) = mpsc::channel(64);
        let outgoing = ReceiverStream::new(outgoing);
        let answers = EnvironmentClient::new(channel).process(outgoing).await.unwrap().into_inner();
        Self { requests, answers }
    }

    async fn send(&self, request: Request) {
        let request = wire::EnvironmentRequest { payload: Some(request) };
        self.requests.send(request).await.unwrap();
    }

    async fn receive(&mut self) -> Response {
        soon(self.answers.message()).await.unwrap().unwrap().payload.unwrap()
    }

    async fn ask(&mut self, request: Request) -> Response {
        self.send(request).await;
        self.receive().await
    }

    async fn create(&mut self, seed: i64) -> String {
        self.create_of("hopper", seed).await
    }

    async fn create_of(&mut self, env_id: &str, seed: i64) -> String {
        let env_id = tensor::Payload::Strings(tensor::StringArray { array: vec![env_id.into()] });
        let seed = tensor::Payload::Int64s(tensor::Int64Array { array: vec![seed] });
        let settings = [("env_id", env_id), ("seed", seed)]
            .map(|(name, payload)| (name.to_owned(), scalar(payload)))
            .into();
        match self.ask(Request::CreateWorld(wire::CreateWorldRequest { settings })).await {
            Response::CreateWorld(created) => created.world_name,
            other => panic!("{other:?}"),
        }
    }

    async fn join(&mut self, world_name: &str) {
        let answer = self.ask(join(world_name)).await;
        assert!(matches!(answer, Response::JoinWorld(_)), "{answer:?}");
    }

    async fn step(&mut self) -> (State, Vec<f64>) {
        stepped(self.ask(step(0.5)).await)
    }

    #[track_caller]
    fn check_error(answer: Response, code: Code, text: &str) {
        let Response::Error(status) = answer else { panic!("{answer:?}") };
        assert_eq!(Code::from_i32(status.code), code, "{}", status.message);
        assert!(status.message.contains(text), "{}", status.message);
        assert!(!status.details.is_empty());
    }
}

fn scalar(payload: tensor::Payload) -> wire::Tensor {
    wire::Tensor { payload: Some(payload), shape: vec![] }
}

fn join(world_name: &str) -> Request {
    let settings = BTreeMap::new();
    Request::JoinWorld(wire::JoinWorldRequest { world_name: world_name.into(), settings })
}

fn step(action: f32) -> Request {
    let action = scalar(tensor::Payload::Floats(tensor::FloatArray { array: vec![action] }));
    Request::Step(wire::StepRequest {
        actions: BTreeMap::from([(1, action)]),
        requested_observations: vec![1],
    })
}

fn reset_world(world_name: &str) -> Request {
    let settings = BTreeMap::new();
    Request::ResetWorld(wire::ResetWorldRequest { world_name: world_name.into(), settings })
}

fn destroy(world_name: &str) -> Request {
    Request::DestroyWorld(wire::DestroyWorldRequest { world_name: world_name.into() })
}

#[track_caller]
fn stepped(answer: Response) -> (State, Vec<f64>) {
    let Response::Step(mut step) = answer else { panic!("{answer:?}") };
    let observation = step.observations.remove(&1).unwrap();
    let Some(tensor::Payload::Doubles(doubles)) = observation.payload else {
        panic!("{observation:?}")
    };
    (step.state(), doubles.array)
}

#[tokio::test]
async fn resetting_a_world_interrupts_every_running_episode_in_it_once_and_starts_from_its_seed() {
    let server = TestServer::with_defaults().await;
    let mut first = Connection::open(server.channel().await).await;
    let mut second = Connection::open(server.channel().await).await;
    let mut third = Connection::open(server.channel().await).await;
    let world = first.create(3).await;
    for connection in [&mut first, &mut second, &mut third] {
        connection.join(&world).await;
    }
    let (state, start) = first.step().await;
    assert_eq!(state, State::Running);
    assert_eq!(second.step().await, (State::Running, start.clone()));
    let (_, last) = second.step().await;
    // The third has started no episode, so there is none to interrupt.
    assert!(matches!(first.ask(reset_world(&world)).await, Response::ResetWorld(_)));
    assert_eq!(first.step().await, (State::Interrupted, start.clone()));
    assert_eq!(second.step().await, (State::Interrupted, last));
    for connection in [&mut first, &mut second, &mut third] {
        assert_eq!(connection.step().await, (State::Running, start.clone()));
        let (state, next) = connection.step().await;
        assert_eq!(state, State::Running);
        assert_ne!(next, start);
    }
}

#[tokio::test]
async fn a_world_outlives_its_connection_and_one_that_is_joined_is_not_destroyed() {
    let mut config = ServerConfig::default();
    config.limits.max_sessions = 1;
    let server = TestServer::start(config).await;
    let mut creator = Connection::open(server.channel().await).await;
    let world = creator.create(0).await;
    creator.join(&world).await;
    creator.step().await;
    let mut other = Connection::open(server.channel().await).await;
    for asking in [&mut creator, &mut other] {
        let answer = asking.ask(destroy(&world)).await;
        Connection::check_error(answer, Code::FailedPrecondition, "1 joined connections");
    }
    let answer = other.ask(join(&world)).await;
    Connection::check_error(answer, Code::ResourceExhausted, "1 sessions are open");
    // The failed join took nothing; the end of the stream is as good as leaving.
    drop(creator);
    soon(async {
        while let Response::Error(status) = other.ask(join(&world)).await {
            assert_eq!(Code::from_i32(status.code), Code::ResourceExhausted, "{status:?}");
            tokio::task::yield_now().await;
        }
    })
    .await;
    assert_eq!(other.step().await.0, State::Running);
    let leave = Request::LeaveWorld(wire::LeaveWorldRequest {});
    assert!(matches!(other.ask(leave).await, Response::LeaveWorld(_)));
    assert!(matches!(other.ask(destroy(&world)).await, Response::DestroyWorld(_)));
    let answer = other.ask(join(&world)).await;
    Connection::check_error(answer, Code::NotFound, "destroyed");
    other.create(1).await;
    let answer = other.ask(create_hopper()).await;
    Connection::check_error(answer, Code::ResourceExhausted, "1 worlds are open");
}

fn create_hopper() -> Request {
    let args = tensor::StringArray { array: vec![r#"{"env_id": "hopper"}"#.into()] };
    let settings = BTreeMap::from([("args".into(), scalar(tensor::Payload::Strings(args)))]);
    Request::CreateWorld(wire::CreateWorldRequest { settings })
}

#[tokio::test]
async fn pipelined_requests_are_answered_in_order_and_one_that_fails_changes_nothing() {
    let server = TestServer::with_defaults().await;
    let mut plain = Connection::open(server.channel().await).await;
    let world = plain.create(5).await;
    plain.join(&world).await;
    let mut expected = Vec::new();
    for _ in 0..3 {
        expected.push(plain.step().await);
    }
    let mut piped = Connection::open(server.channel().await).await;
    let extension = Request::Extension(prost_types::Any::default());
    for request in [
        step(0.0),
        join(&world),
        step(0.5),
        join(&world),
        step(0.5),
        step(2.0),
        step(f32::NAN),
        extension,
        reset_world("elsewhere"),
        step(0.5),
    ] {
        piped.send(request).await;
    }
    let error = Connection::check_error;
    error(piped.receive().await, Code::FailedPrecondition, "joined no world");
    assert!(matches!(piped.receive().await, Response::JoinWorld(_)));
    assert_eq!(stepped(piped.receive().await), expected[0]);
    error(piped.receive().await, Code::FailedPrecondition, "already");
    assert_eq!(stepped(piped.receive().await), expected[1]);
    error(piped.receive().await, Code::InvalidArgument, "has 2 at index 0");
    error(piped.receive().await, Code::InvalidArgument, "NaN");
    error(piped.receive().await, Code::Unimplemented, "no extensions");
    error(piped.receive().await, Code::NotFound, "\"elsewhere\" not found");
    assert_eq!(stepped(piped.receive().await), expected[2]);
}

#[tokio::test]
async fn a_client_that_sends_without_reading_is_not_read_either() {
    let server = TestServer::with_defaults().await;
    let mut connection = Connection::open(server.channel().await).await;
    // Answers of 6 kB and requests of 50 kB soon fill the windows of both directions.
    let world = connection.create_of("hopper-full-w64", 5).await;
    connection.join(&world).await;
    let Request::Step(mut flood) = step(0.0) else { panic!("another request") };
    flood.requested_observations = vec![1; 50_000];
    let mut sent = 0;
    let pause = std::time::Duration::from_secs(2);
    let send = async || connection.send(Request::Step(flood.clone())).await;
    while tokio::time::timeout(pause, send()).await.is_ok() {
        sent += 1;
        assert!(sent < 10_000, "the server reads without end");
    }
    let mut other = Connection::open(server.channel().await).await;
    other.join(&world).await;
    assert_eq!(other.step().await.0, State::Running);
}
