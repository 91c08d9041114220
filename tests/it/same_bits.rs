//! The same bits whatever carries them: numbers of environments and threads, transports, ways of
//! asking.

use hyper_util::rt::TokioIo;
use palr_gym_proto::v1;
use palr_gym_proto::v1::environment_service_client::EnvironmentServiceClient;
use palr_gym_server::{Listener, Server, ServerConfig};
use palr_gym_trainer::Client;
use palr_gym_trainer::session::Session;
use tonic::transport::{Channel, Endpoint, Uri};

use crate::support::{TestServer, float32, open};

const STEPS: usize = 45;
const NUM_ENVS: usize = 5;
const SEED: u64 = 21;

/// The action of environment `env`, whatever vector it is in.
fn action(env: usize, step: usize, size: usize) -> Vec<f32> {
    (0..size).map(|i| (((env * 13 + step * 31 + i * 7) % 21) as f32 - 10.0) / 10.0).collect()
}

fn rows(envs: std::ops::Range<usize>, step: usize, size: usize) -> Vec<f32> {
    envs.flat_map(|env| action(env, step, size)).collect()
}

/// Everything that came of each environment and step: observation, reward, flags and info as bytes.
type Trajectories = Vec<Vec<Vec<u8>>>;

/// Sorts the bytes of an answer to `steps` steps by environment.
fn sort(answer: &v1::StepResponse, steps: usize, num_envs: usize, into: &mut [Vec<Vec<u8>>]) {
    let tensors = [
        &answer.observations,
        &answer.rewards,
        &answer.terminated,
        &answer.truncated,
        &answer.info,
    ];
    for step in 0..steps {
        for (env, trajectory) in into.iter_mut().enumerate() {
            let mut bytes = Vec::new();
            for tensor in tensors {
                let data = &tensor.as_ref().unwrap().data;
                let size = data.len() / (steps * num_envs);
                let row = step * num_envs + env;
                bytes.extend_from_slice(&data[row * size..(row + 1) * size]);
            }
            trajectory.push(bytes);
        }
    }
}

fn action_size(session: &Session) -> usize {
    session.spec().action_space.as_ref().unwrap().names.len()
}

/// One session of all environments, one step at a time.
async fn in_one_vector(client: &Client, env_id: &str) -> Trajectories {
    let mut session = Session::open(client, open(env_id, NUM_ENVS as u32)).await.unwrap();
    let size = action_size(&session);
    let mut trajectories = vec![Vec::new(); NUM_ENVS];
    session.reset(vec![SEED]).await.unwrap();
    for step in 0..STEPS {
        let answer = session.step(&rows(0..NUM_ENVS, step, size)).await.unwrap();
        sort(&answer, 1, NUM_ENVS, &mut trajectories);
    }
    trajectories
}

/// A session for each environment.
async fn one_by_one(client: &Client, env_id: &str) -> Trajectories {
    let mut trajectories = Vec::new();
    for env in 0..NUM_ENVS {
        let mut session = Session::open(client, open(env_id, 1)).await.unwrap();
        let size = action_size(&session);
        session.reset(vec![SEED + env as u64]).await.unwrap();
        let mut trajectory = vec![Vec::new()];
        for step in 0..STEPS {
            let answer = session.step(&rows(env..env + 1, step, size)).await.unwrap();
            sort(&answer, 1, 1, &mut trajectory);
        }
        trajectories.append(&mut trajectory);
    }
    trajectories
}

/// All steps in one message, after some that are forgotten, from a snapshot.
async fn in_an_open_loop(client: &Client, env_id: &str) -> Trajectories {
    let mut session = Session::open(client, open(env_id, NUM_ENVS as u32)).await.unwrap();
    let size = action_size(&session);
    session.reset(vec![SEED]).await.unwrap();
    let start = session.snapshot().await.unwrap();
    session.step_open_loop(&vec![0.5; 30 * NUM_ENVS * size], 30).await.unwrap();
    session.restore(start).await.unwrap();
    let all: Vec<f32> = (0..STEPS).flat_map(|step| rows(0..NUM_ENVS, step, size)).collect();
    let answer = session.step_open_loop(&all, STEPS).await.unwrap();
    let mut trajectories = vec![Vec::new(); NUM_ENVS];
    sort(&answer, STEPS, NUM_ENVS, &mut trajectories);
    trajectories
}

/// Calls instead of a stream.
async fn by_unary_calls(channel: Channel, env_id: &str) -> Trajectories {
    let mut service = EnvironmentServiceClient::new(channel);
    let opened = service.open_session(open(env_id, NUM_ENVS as u32)).await.unwrap().into_inner();
    let size = opened.spec.unwrap().action_space.unwrap().names.len();
    let session_id = opened.session_id;
    let reset =
        v1::ResetRequest { session_id: session_id.clone(), seeds: vec![SEED], env_indices: vec![] };
    service.reset(reset).await.unwrap();
    let mut trajectories = vec![Vec::new(); NUM_ENVS];
    for step in 0..STEPS {
        let actions = float32(&rows(0..NUM_ENVS, step, size), &[NUM_ENVS as i64, size as i64]);
        let request = v1::StepRequest { session_id: session_id.clone(), actions: Some(actions) };
        let answer = service.step(request).await.unwrap().into_inner();
        sort(&answer, 1, NUM_ENVS, &mut trajectories);
    }
    trajectories
}

/// A server inside this process, without a socket.
async fn in_process(simulation_threads: usize) -> Client {
    let (ours, theirs) = tokio::io::duplex(1 << 20);
    let server = Server::new(ServerConfig { simulation_threads, ..ServerConfig::default() });
    tokio::spawn(server.unwrap().serve(vec![Listener::InProcess(theirs)], std::future::pending()));
    let mut ours = Some(TokioIo::new(ours));
    let connector = tower::service_fn(move |_: Uri| {
        let ours = ours.take().ok_or_else(|| std::io::Error::other("taken already"));
        async move { ours }
    });
    let endpoint = Endpoint::from_static("http://in-process");
    Client::from_channel(endpoint.connect_with_connector(connector).await.unwrap())
}

#[tokio::test]
async fn nothing_about_the_way_changes_a_bit() {
    let mut servers = Vec::new();
    for simulation_threads in [1, 3] {
        let config = ServerConfig { simulation_threads, ..ServerConfig::default() };
        servers.push(TestServer::start(config).await);
    }
    let env_ids = [
        "hopper-w2",
        "walker2d-gym5-w3",
        "halfcheetah",
        "ant-gym5",
        "lane-full-w2",
        "town",
        "toy-w2",
    ];
    for env_id in env_ids {
        let expected = in_one_vector(&in_process(2).await, env_id).await;
        assert_eq!((expected.len(), expected[0].len()), (NUM_ENVS, STEPS));
        for server in &servers {
            for address in [&server.tcp, &server.unix] {
                let client = Client::connect(address).await.unwrap();
                assert!(in_one_vector(&client, env_id).await == expected, "{env_id}, {address}");
            }
            let client = server.client().await;
            assert!(one_by_one(&client, env_id).await == expected, "{env_id}, one by one");
            assert!(in_an_open_loop(&client, env_id).await == expected, "{env_id}, open loop");
            let channel = server.channel().await;
            assert!(by_unary_calls(channel, env_id).await == expected, "{env_id}, unary");
        }
    }
}
