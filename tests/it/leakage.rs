//! Leakage over the wire.

use palr_gym_leakage::{HscicConfig, block_bootstrap, hscic};
use palr_gym_proto::v1;
use palr_gym_proto::v1::estimate_leakage_request::Subject;
use palr_gym_proto::v1::leakage_service_client::LeakageServiceClient;
use tonic::Code;
use tonic_types::StatusExt;

use crate::support::{TestServer, expert, float32};

/// Actions of period 40 in three dimensions, within ±1.
fn waves(n: usize, phase: f64) -> Vec<f32> {
    let angle = |i: usize, j: usize| (i as f64 + phase) * 0.157 * (j + 1) as f64;
    (0..n).flat_map(|i| (0..3).map(move |j| (0.9 * angle(i, j).sin()) as f32)).collect()
}

fn request(n: usize) -> v1::EstimateLeakageRequest {
    let tensor = |phase| Some(float32(&waves(n, phase), &[n as i64, 3]));
    v1::EstimateLeakageRequest {
        subject: tensor(0.4).map(Subject::Representation),
        past_actions: tensor(-1.0),
        given_actions: tensor(0.0),
        ..v1::EstimateLeakageRequest::default()
    }
}

#[tokio::test]
async fn the_rpc_is_the_estimator() {
    let server = TestServer::with_defaults().await;
    let mut service = LeakageServiceClient::new(server.channel().await);
    let n = 120;
    let lengths = vec![5_u32; 24];
    let asked =
        v1::EstimateLeakageRequest { episode_lengths: lengths.clone(), seed: 3, ..request(n) };
    let got = service.estimate_leakage(asked).await.unwrap().into_inner();

    let matrix = |phase| {
        let values = waves(n, phase);
        faer::Mat::from_fn(n, 3, |i, j| f64::from(values[i * 3 + j]))
    };
    let (x, y, z) = (matrix(0.4), matrix(-1.0), matrix(0.0));
    let expected = hscic(x.as_ref(), y.as_ref(), z.as_ref(), &HscicConfig::default()).unwrap();
    assert!((got.hscic - expected.value).abs() <= 1e-12, "{} {}", got.hscic, expected.value);
    let lengths: Vec<usize> = lengths.iter().map(|&n| n as usize).collect();
    let interval = block_bootstrap(&expected.per_point, &lengths, 2000, 3).unwrap();
    assert!((got.hscic_low - interval.low).abs() <= 1e-12);
    assert!(got.is_by_episode && got.hscic_low <= got.hscic && got.hscic <= got.hscic_high);
    assert_eq!(got.per_point.unwrap().shape, [n as i64]);
}

#[tokio::test]
async fn a_policys_actions_are_what_leaks() {
    let server = TestServer::with_defaults().await;
    let mut service = LeakageServiceClient::new(server.channel().await);
    let n = 60;
    let observations = float32(&vec![0.1; n * 11], &[n as i64, 11]);
    let subject = v1::PolicyOnObservations {
        policy: Some(expert()),
        env_id: "hopper".into(),
        observations: Some(observations),
        action_mode: v1::ActionMode::Deterministic.into(),
    };
    let asked = v1::EstimateLeakageRequest {
        subject: Some(Subject::Policy(subject.clone())),
        ..request(n)
    };
    let constant = service.estimate_leakage(asked).await.unwrap().into_inner();
    // The same observation each time: the same action, which can depend on nothing.
    assert!(constant.hscic.abs() < 1e-4, "{}", constant.hscic);

    // A controller sees more than observations.
    let driver = v1::PolicyOnObservations {
        env_id: "lane".into(),
        observations: Some(float32(&vec![0.1; n * 12], &[n as i64, 12])),
        ..subject.clone()
    };
    let asked = v1::EstimateLeakageRequest { subject: Some(Subject::Policy(driver)), ..request(n) };
    let status = service.estimate_leakage(asked).await.unwrap_err();
    assert_eq!(status.code(), Code::NotFound);
    assert!(status.message().contains("no expert model ships for task \"lane\""), "{status}");

    let blind = v1::PolicyOnObservations { env_id: "hopper-w2".into(), ..subject };
    let asked = v1::EstimateLeakageRequest { subject: Some(Subject::Policy(blind)), ..request(n) };
    let status = service.estimate_leakage(asked).await.unwrap_err();
    assert!(status.message().contains("expected [n, 10] for hopper-w2-v0"), "{status}");
}

#[tokio::test]
async fn wrong_arrays_are_refused() {
    let server = TestServer::with_defaults().await;
    let mut service = LeakageServiceClient::new(server.channel().await);
    let mut nan = waves(10, 0.0);
    nan[7] = f32::NAN;
    let mut torn = float32(&waves(10, 0.0), &[10, 3]);
    torn.data.truncate(100);
    let given = |tensor| v1::EstimateLeakageRequest { given_actions: Some(tensor), ..request(10) };
    for (asked, reason, text) in [
        (given(float32(&waves(9, 0.0), &[9, 3])), "SAMPLE_COUNT", "given_action has 9 rows"),
        (given(float32(&nan, &[10, 3])), "ARRAY_NOT_FINITE", "NaN at row 2, column 1"),
        (given(torn), "ARRAY_SHAPE", "as many bytes as shape and dtype say"),
        (given(float32(&waves(10, 0.0), &[30])), "ARRAY_SHAPE", "two dimensions"),
        (given(float32(&[], &[5000, 0])), "ARRAY_SHAPE", "at most 4096 rows"),
        (given(float32(&[], &[-1, 3])), "ARRAY_SHAPE", "two dimensions"),
        (
            given(float32(&[0.5; 30], &[10, 3])),
            "ARRAY_CONSTANT",
            "column 0 of given_action is 0.5 in all 10 samples",
        ),
        (request(1), "SAMPLE_COUNT", "1 samples; expected at least 2"),
        (
            v1::EstimateLeakageRequest { ridge: Some(0.0), ..request(10) },
            "OUT_OF_RANGE",
            "ridge is 0",
        ),
        (
            v1::EstimateLeakageRequest { episode_lengths: vec![4], ..request(10) },
            "EPISODE_LENGTHS",
            "blocks hold 4 samples",
        ),
        (
            v1::EstimateLeakageRequest { subject: None, ..request(10) },
            "MISSING",
            "subject is not set",
        ),
    ] {
        let status = service.estimate_leakage(asked).await.unwrap_err();
        let info = status.get_details_error_info().unwrap();
        assert_eq!(
            (status.code(), info.reason.as_str()),
            (Code::InvalidArgument, reason),
            "{status}"
        );
        assert!(status.message().contains(text), "{status}");
    }
}
