//! Sessions over the wire.

use palr_gym_proto::v1;
use palr_gym_proto::v1::environment_service_client::EnvironmentServiceClient;
use palr_gym_proto::v1::step_stream_request::Request;
use palr_gym_proto::v1::step_stream_response::Response;
use palr_gym_trainer::session::Session;
use tonic::Code;

use crate::support::{TestServer, float32, open, soon};

/// Actions that keep a hopper busy for a while, different in each step.
fn actions(step: usize, count: usize) -> Vec<f32> {
    (0..count).map(|i| (((step * 31 + i * 7) % 21) as f32 - 10.0) / 10.0).collect()
}

async fn play(session: &mut Session, steps: usize) -> Vec<v1::StepResponse> {
    let count = session.num_envs() * 3;
    session.reset(vec![9]).await.unwrap();
    let mut answers = Vec::new();
    for step in 0..steps {
        answers.push(session.step(&actions(step, count)).await.unwrap());
    }
    answers
}

#[tokio::test]
async fn bits_do_not_depend_on_the_transport_or_on_pipelining() {
    let server = TestServer::with_defaults().await;
    let mut rollouts = Vec::new();
    for address in [&server.tcp, &server.unix] {
        let client = palr_gym_trainer::Client::connect(address).await.unwrap();
        let mut session = Session::open(&client, open("hopper-w2", 5)).await.unwrap();
        rollouts.push(play(&mut session, 60).await);
        session.close().await.unwrap();
    }
    let client = server.client().await;
    let mut session = Session::open(&client, open("hopper-w2", 5)).await.unwrap();
    session.reset(vec![9]).await.unwrap();
    for step in 0..60 {
        session.send_step(&actions(step, 15)).unwrap();
    }
    let mut pipelined = Vec::new();
    for _ in 0..60 {
        pipelined.push(session.receive_step().await.unwrap());
    }
    rollouts.push(pipelined);
    assert_eq!(rollouts[0], rollouts[1]);
    assert_eq!(rollouts[0], rollouts[2]);
    let ended =
        rollouts[0].iter().any(|answer| answer.terminated.as_ref().unwrap().data.contains(&1));
    assert!(ended, "no episode ended; the test proves less than it should");
}

#[tokio::test]
async fn an_error_answers_its_own_request_and_leaves_stream_and_session_as_they_were() {
    let server = TestServer::with_defaults().await;
    let mut service = EnvironmentServiceClient::new(server.channel().await);
    let session_id = service.open_session(open("hopper", 1)).await.unwrap().into_inner().session_id;
    let reset =
        v1::ResetRequest { session_id: session_id.clone(), seeds: vec![1], env_indices: vec![] };
    let step = |values: &[f32]| {
        let actions = Some(float32(values, &[1, values.len() as i64]));
        // Unset after the first request: the session of the request before.
        Request::Step(v1::StepRequest { session_id: String::new(), actions })
    };
    let requests = [
        Request::Reset(reset.clone()),
        step(&[0.5, 0.5, 0.5]),
        step(&[0.5, f32::NAN, 0.5]),
        step(&[0.5, 2.0, 0.5]),
        step(&[0.5]),
        step(&[-0.5, 0.5, 0.0]),
    ]
    .map(|request| v1::StepStreamRequest { request: Some(request) });
    let mut answers = service.step_stream(tokio_stream::iter(requests)).await.unwrap().into_inner();
    let mut kinds = Vec::new();
    let mut last = None;
    while let Some(answer) = soon(answers.message()).await.unwrap() {
        kinds.push(match answer.response.unwrap() {
            Response::Reset(_) => "reset".to_owned(),
            Response::Step(step) => {
                last = Some(step);
                "step".to_owned()
            }
            Response::Error(status) => {
                // ErrorInfo and BadRequest, as a unary call would have carried them.
                format!("{:?}: {}", Code::from_i32(status.code), status.details.len())
            }
        });
    }
    let error = "InvalidArgument: 2".to_owned();
    assert_eq!(kinds, ["reset", "step", &error, &error, &error, "step"]);

    // The same without the errors, unary.
    service.reset(reset).await.unwrap();
    let mut unary = None;
    for values in [[0.5, 0.5, 0.5], [-0.5, 0.5, 0.0]] {
        let actions = Some(float32(&values, &[1, 3]));
        let request = v1::StepRequest { session_id: session_id.clone(), actions };
        unary = Some(service.step(request).await.unwrap().into_inner());
    }
    assert_eq!(unary, last);
}

#[tokio::test]
async fn a_message_beyond_the_size_limit_ends_the_stream_with_the_reason() {
    let server = TestServer::with_defaults().await;
    let mut service = EnvironmentServiceClient::new(server.channel().await);
    let huge = float32(&vec![0.0; 2 << 20], &[2 << 20]);
    let step = v1::StepRequest { session_id: String::new(), actions: Some(huge) };
    let request = v1::StepStreamRequest { request: Some(Request::Step(step)) };
    let requests = tokio_stream::iter([request]);
    let mut answers = service.step_stream(requests).await.unwrap().into_inner();
    let status = soon(answers.message()).await.unwrap_err();
    assert_eq!(status.code(), Code::OutOfRange, "{status}");
    assert!(status.message().contains("4194304"), "{status}");
}

#[tokio::test]
async fn a_client_that_reads_nothing_is_bounded_and_others_go_on() {
    let server = TestServer::with_defaults().await;
    let client = server.client().await;
    let mut greedy = Session::open(&client, open("hopper", 64)).await.unwrap();
    greedy.reset(vec![0]).await.unwrap();
    for step in 0..500 {
        greedy.send_step(&actions(step, 192)).unwrap();
    }
    let other = palr_gym_trainer::Client::connect(&server.tcp).await.unwrap();
    let mut session = Session::open(&other, open("hopper", 1)).await.unwrap();
    soon(play(&mut session, 50)).await;
    // And the greedy one still gets every answer, in order.
    for _ in 0..500 {
        greedy.receive_step().await.unwrap();
    }
}

#[tokio::test]
async fn reflection_names_every_service() {
    use tonic_reflection::pb::v1::ServerReflectionRequest;
    use tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient;
    use tonic_reflection::pb::v1::server_reflection_request::MessageRequest;
    use tonic_reflection::pb::v1::server_reflection_response::MessageResponse;

    let server = TestServer::with_defaults().await;
    let mut reflection = ServerReflectionClient::new(server.channel().await);
    let request = ServerReflectionRequest {
        host: String::new(),
        message_request: Some(MessageRequest::ListServices(String::new())),
    };
    let mut answers =
        reflection.server_reflection_info(tokio_stream::once(request)).await.unwrap().into_inner();
    let answer = answers.message().await.unwrap().unwrap().message_response.unwrap();
    let MessageResponse::ListServicesResponse(list) = answer else { panic!("{answer:?}") };
    let names: Vec<&str> = list.service.iter().map(|service| service.name.as_str()).collect();
    for name in ["Environment", "Evaluation", "Collection", "Leakage", "Server", "Snapshot"] {
        assert!(names.contains(&format!("palr_gym.v1.{name}Service").as_str()), "{names:?}");
    }
    assert!(names.contains(&"grpc.health.v1.Health"));
}
