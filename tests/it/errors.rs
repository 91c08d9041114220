//! Every refusal: its code, its reason, its text with the offending value and what was expected.

use palr_gym_proto::v1;
use palr_gym_proto::v1::collection_service_client::CollectionServiceClient;
use palr_gym_proto::v1::environment_service_client::EnvironmentServiceClient;
use palr_gym_proto::v1::evaluation_service_client::EvaluationServiceClient;
use tonic::{Code, Status};
use tonic_types::StatusExt;

use crate::support::{TestServer, float32, open, random};

#[track_caller]
fn check(status: &Status, code: Code, reason: &str, text: &str) {
    let info = status.get_details_error_info().expect("no ErrorInfo");
    assert_eq!(
        (status.code(), info.reason.as_str(), info.domain.as_str()),
        (code, reason, "palr_gym")
    );
    assert!(status.message().contains(text), "{}", status.message());
    if code == Code::InvalidArgument {
        let violations = status.get_details_bad_request().expect("no BadRequest");
        assert!(!violations.field_violations[0].field.is_empty());
    }
    if code == Code::ResourceExhausted {
        assert!(status.get_details_retry_info().is_some());
    }
}

#[tokio::test]
async fn wrong_environments_are_refused() {
    let server = TestServer::with_defaults().await;
    let mut service = EnvironmentServiceClient::new(server.channel().await);
    for (env_id, num_envs, code, reason, text) in [
        ("hoper-w2", 1, Code::NotFound, "UNKNOWN_TASK", "did you mean \"hopper\"?"),
        ("", 1, Code::InvalidArgument, "INVALID_ENV_ID", "names no task"),
        ("hopper-blurred", 1, Code::InvalidArgument, "INVALID_ENV_ID", "\"blurred\""),
        ("hopper-w2-v7", 1, Code::InvalidArgument, "INVALID_ENV_ID", "version v7"),
        ("hopper-w0", 1, Code::InvalidArgument, "INVALID_ENV_ID", "stack of 0; expected 1 to 64"),
        ("hopper-w10000", 1, Code::InvalidArgument, "INVALID_ENV_ID", "stack of 10000"),
        ("hopper", 0, Code::InvalidArgument, "NUM_ENVS", "num_envs is 0; expected 1 to 4096"),
        ("hopper", 1_000_000, Code::InvalidArgument, "NUM_ENVS", "num_envs is 1000000"),
    ] {
        let status = service.open_session(open(env_id, num_envs)).await.unwrap_err();
        check(&status, code, reason, text);
    }
    let wrong_mode = v1::OpenSessionRequest { autoreset_mode: 77, ..open("hopper", 1) };
    let status = service.open_session(wrong_mode).await.unwrap_err();
    check(&status, Code::InvalidArgument, "UNKNOWN_ENUM", "autoreset_mode is 77");
}

#[tokio::test]
async fn wrong_steps_are_refused() {
    let server = TestServer::with_defaults().await;
    let mut service = EnvironmentServiceClient::new(server.channel().await);
    let session_id = service.open_session(open("hopper", 2)).await.unwrap().into_inner().session_id;
    let step =
        |actions: Option<v1::Tensor>| v1::StepRequest { session_id: session_id.clone(), actions };
    let good = float32(&[0.0; 6], &[2, 3]);

    let status = service.step(step(Some(good.clone()))).await.unwrap_err();
    check(&status, Code::FailedPrecondition, "RESET_NEEDED", "reset them before the first step");
    for (seeds, env_indices, reason, text) in [
        (vec![1, 2, 3], vec![], "SEED_COUNT", "3 seeds for 2 environments"),
        (vec![], vec![2], "ENV_INDEX", "environment index 2"),
        (vec![], vec![1, 0], "ENV_INDEX", "environment index 0 after Some(1)"),
    ] {
        let request = v1::ResetRequest { session_id: session_id.clone(), seeds, env_indices };
        let status = service.reset(request).await.unwrap_err();
        check(&status, Code::InvalidArgument, reason, text);
    }
    let reset =
        v1::ResetRequest { session_id: session_id.clone(), seeds: vec![0], env_indices: vec![] };
    service.reset(reset).await.unwrap();

    let mut wide = good.clone();
    wide.dtype = v1::DataType::Float64.into();
    let mut torn = good.clone();
    torn.data.truncate(23);
    let nan = float32(&[0.0, 0.0, 0.0, 0.0, f32::NAN, 0.0], &[2, 3]);
    let beyond = float32(&[0.0, 0.0, 0.0, 0.0, 0.0, -1.25], &[2, 3]);
    for (actions, reason, text) in [
        (None, "MISSING", "actions is not set"),
        (Some(wide), "ACTION_DTYPE", "dtype float64; expected float32"),
        (Some(torn), "ACTION_SHAPE", "23 bytes; expected [2, 3]"),
        (Some(float32(&[0.0; 6], &[3, 2])), "ACTION_SHAPE", "shape [3, 2]"),
        (Some(float32(&[0.0; 6], &[6])), "ACTION_SHAPE", "shape [6]"),
        (Some(nan), "ACTION_NAN", "environment 1 has NaN at index 1 (leg_joint)"),
        (Some(beyond), "ACTION_OUT_OF_BOUNDS", "environment 1 has -1.25 at index 2"),
    ] {
        let status = service.step(step(actions)).await.unwrap_err();
        check(&status, Code::InvalidArgument, reason, text);
    }
    service.step(step(Some(good.clone()))).await.unwrap();

    for id in ["", "nonsense", "00000000-0000-0000-0000-000000000000"] {
        let request = v1::StepRequest { session_id: id.into(), actions: Some(good.clone()) };
        let status = service.step(request).await.unwrap_err();
        check(&status, Code::NotFound, "SESSION_NOT_FOUND", &format!("session {id:?} not found"));
    }
}

#[tokio::test]
async fn wrong_rollouts_are_refused() {
    let server = TestServer::with_defaults().await;
    let mut service = EvaluationServiceClient::new(server.channel().await);
    let onnx = |bytes: &'static [u8]| {
        Some(v1::Policy { policy: Some(v1::policy::Policy::Onnx(bytes.into())) })
    };
    const HOPPER: &[u8] = include_bytes!("../../scenes/experts/hopper.onnx");
    let base = |env_id: &str, policy| v1::EvaluateRequest {
        env_id: env_id.into(),
        policy,
        episodes: Some(1),
        ..v1::EvaluateRequest::default()
    };
    let none = v1::EvaluateRequest { episodes: Some(0), ..base("hopper", Some(random())) };
    let crowd = v1::EvaluateRequest { num_envs: Some(9999), ..base("hopper", Some(random())) };
    let scene = |env_id: &str, scene_options| v1::EvaluateRequest {
        scene_options: Some(scene_options),
        ..base(env_id, Some(random()))
    };
    let vehicles = |count| v1::SceneOptions { vehicles: Some(count), ..Default::default() };
    let probability =
        v1::SceneOptions { lead_car_probability: Some(1.5), ..v1::SceneOptions::default() };
    let (bad, text) = (Code::InvalidArgument, "SCENE_OPTIONS");
    for (request, expected) in [
        (scene("hopper", vehicles(1)), "task \"hopper\" has no scene options"),
        (scene("lane", vehicles(1)), "task \"lane\" has no scene option \"vehicles\""),
        (
            scene("lane", probability),
            "lead_car_probability is 1.5; expected a number within [0, 1]",
        ),
        (scene("town", probability), "task \"town\" has no scene option \"lead_car_probability\""),
        (scene("town", vehicles(9)), "vehicles is 9; expected 0 to 8"),
    ] {
        let status = service.evaluate(request).await.unwrap_err();
        check(&status, bad, text, expected);
    }
    for (request, code, reason, text) in [
        (base("hopper", None), Code::InvalidArgument, "MISSING", "policy is not set"),
        (none, Code::InvalidArgument, "OUT_OF_RANGE", "episodes is 0; expected 1 to"),
        (crowd, Code::InvalidArgument, "NUM_ENVS", "num_envs is 9999"),
        (base("hopper", onnx(b"junk")), Code::InvalidArgument, "POLICY_NOT_ONNX", "no ONNX model"),
        (
            base("hopper-w2", onnx(HOPPER)),
            Code::InvalidArgument,
            "POLICY_SHAPE",
            "expected float32 [N, 10]",
        ),
    ] {
        let status = service.evaluate(request).await.unwrap_err();
        check(&status, code, reason, text);
    }
    let huge =
        v1::Policy { policy: Some(v1::policy::Policy::Onnx(vec![0; (32 << 20) + 1].into())) };
    let status = service.evaluate(base("hopper", Some(huge))).await.unwrap_err();
    check(&status, Code::InvalidArgument, "POLICY_TOO_LARGE", "at most 33554432 are allowed");

    let mut collection = CollectionServiceClient::new(server.channel().await);
    let request = v1::CollectRequest {
        env_id: "hopper".into(),
        policy: Some(random()),
        ..v1::CollectRequest::default()
    };
    let status = collection.collect(request).await.unwrap_err();
    check(&status, Code::InvalidArgument, "MISSING", "expected transitions or episodes");
}
