//! What a shutdown does to work that is under way.

use palr_gym_proto::v1;
use palr_gym_proto::v1::environment_service_client::EnvironmentServiceClient;
use palr_gym_proto::v1::evaluation_service_client::EvaluationServiceClient;
use palr_gym_trainer::session::Session;
use tonic::Code;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

use crate::support::{TestServer, open, random, soon};

#[tokio::test]
async fn a_drained_server_says_so_refuses_new_work_and_ends_without_an_error() {
    let mut server = TestServer::with_defaults().await;
    let channel = server.channel().await;
    let request = HealthCheckRequest { service: "palr_gym.v1.EnvironmentService".into() };
    let mut health = HealthClient::new(channel.clone());
    let checked = health.check(request.clone()).await.unwrap().into_inner();
    assert_eq!(checked.status(), ServingStatus::Serving);
    let mut watched = health.watch(request).await.unwrap().into_inner();
    assert_eq!(watched.message().await.unwrap().unwrap().status(), ServingStatus::Serving);

    let client = server.client().await;
    let mut session = Session::open(&client, open("hopper", 1)).await.unwrap();
    session.reset(vec![0]).await.unwrap();
    let mut evaluation = EvaluationServiceClient::new(channel.clone())
        .evaluate(v1::EvaluateRequest {
            env_id: "hopper".into(),
            policy: Some(random()),
            episodes: Some(1_000_000),
            ..v1::EvaluateRequest::default()
        })
        .await
        .unwrap()
        .into_inner();
    assert!(evaluation.message().await.unwrap().is_some());

    server.stop();
    assert_eq!(soon(watched.message()).await.unwrap().unwrap().status(), ServingStatus::NotServing);
    let end = soon(async {
        loop {
            match evaluation.message().await {
                Ok(Some(_)) => {}
                Ok(None) => panic!("the evaluation ended as if it were complete"),
                Err(status) => return status,
            }
        }
    })
    .await;
    assert_eq!(end.code(), Code::Unavailable, "{end}");
    assert!(soon(session.step(&[0.0; 3])).await.is_err());
    drop((watched, health, channel, client, session, evaluation));
    assert!(server.ended().await);
}

#[tokio::test]
async fn cancelling_an_evaluation_frees_its_place() {
    let mut config = palr_gym_server::ServerConfig::default();
    config.limits.max_rollouts = 1;
    let server = TestServer::start(config).await;
    let mut service = EvaluationServiceClient::new(server.channel().await);
    let endless = v1::EvaluateRequest {
        env_id: "hopper".into(),
        policy: Some(random()),
        episodes: Some(1_000_000),
        ..v1::EvaluateRequest::default()
    };
    let mut first = service.evaluate(endless.clone()).await.unwrap().into_inner();
    assert!(first.message().await.unwrap().is_some());
    let refused = service.evaluate(endless.clone()).await.unwrap_err();
    assert_eq!(refused.code(), Code::ResourceExhausted, "{refused}");
    drop(first);
    soon(async {
        while service.evaluate(endless.clone()).await.is_err() {
            tokio::task::yield_now().await;
        }
    })
    .await;
}

#[tokio::test]
async fn a_closed_session_frees_its_environments_and_an_idle_one_is_closed() {
    let mut config = palr_gym_server::ServerConfig::default();
    config.limits.max_envs = 10;
    let server = TestServer::start(config).await;
    let mut service = EnvironmentServiceClient::new(server.channel().await);
    let first = service.open_session(open("hopper", 8)).await.unwrap().into_inner();
    let refused = service.open_session(open("hopper", 3)).await.unwrap_err();
    assert!(refused.message().contains("3 more environments would make 11"), "{refused}");
    let close = v1::CloseSessionRequest { session_id: first.session_id };
    service.close_session(close.clone()).await.unwrap();
    assert_eq!(service.close_session(close).await.unwrap_err().code(), Code::NotFound);
    service.open_session(open("hopper", 10)).await.unwrap();
}
