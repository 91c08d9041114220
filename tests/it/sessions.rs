//! What a session can be asked for beyond plain steps: open loops, float32, `-v5`, divergence.

use palr_gym_proto::v1;
use palr_gym_trainer::error::ClientError;
use palr_gym_trainer::session::Session;
use tonic::Code;

use crate::support::{TestServer, open};

/// Actions that make hoppers fall now and then.
fn actions(step: usize, count: usize) -> Vec<f32> {
    (0..count).map(|i| (((step * 31 + i * 7) % 21) as f32 - 10.0) / 10.0).collect()
}

fn float64(tensor: &Option<v1::Tensor>) -> Vec<f64> {
    let tensor = tensor.as_ref().unwrap();
    assert_eq!(tensor.dtype(), v1::DataType::Float64);
    bytemuck::allocation::pod_collect_to_vec(&tensor.data)
}

fn float32(tensor: &Option<v1::Tensor>) -> Vec<f32> {
    let tensor = tensor.as_ref().unwrap();
    assert_eq!(tensor.dtype(), v1::DataType::Float32);
    bytemuck::allocation::pod_collect_to_vec(&tensor.data)
}

#[track_caller]
fn check(error: &ClientError, expected_code: Code, expected_reason: &str, text: &str) {
    let ClientError::Status { code, reason, message } = error else { panic!("{error}") };
    assert_eq!((*code, reason.as_deref()), (expected_code, Some(expected_reason)), "{message}");
    assert!(message.contains(text), "{message}");
}

/// The arrays of single steps, laid end to end, are those of the open loop.
#[tokio::test]
async fn an_open_loop_answers_with_what_single_steps_would_have() {
    const STEPS: usize = 40;
    let server = TestServer::with_defaults().await;
    let client = server.client().await;
    for mode in [v1::AutoresetMode::NextStep, v1::AutoresetMode::SameStep] {
        let request =
            v1::OpenSessionRequest { autoreset_mode: mode.into(), ..open("hopper-gym5-w2", 3) };
        let mut single = Session::open(&client, request.clone()).await.unwrap();
        let mut looped = Session::open(&client, request).await.unwrap();
        single.reset(vec![4]).await.unwrap();
        looped.reset(vec![4]).await.unwrap();
        let rows: Vec<f32> = (0..STEPS).flat_map(|step| actions(step, 9)).collect();
        let answer = looped.step_open_loop(&rows, STEPS).await.unwrap();
        let mut steps = Vec::new();
        for row in rows.chunks_exact(9) {
            steps.push(single.step(row).await.unwrap());
        }
        type Field = fn(&v1::StepResponse) -> &Option<v1::Tensor>;
        let fields: [(Field, &[i64]); 5] = [
            (|answer| &answer.observations, &[3, 10]),
            (|answer| &answer.rewards, &[3]),
            (|answer| &answer.terminated, &[3]),
            (|answer| &answer.truncated, &[3]),
            (|answer| &answer.info, &[3, 6]),
        ];
        for (field, shape) in fields {
            let ours = field(&answer).as_ref().unwrap();
            assert_eq!(ours.shape[0], STEPS as i64);
            assert_eq!(ours.shape[1..], *shape);
            let theirs: Vec<u8> =
                steps.iter().flat_map(|step| field(step).as_ref().unwrap().data.to_vec()).collect();
            assert_eq!(ours.data, theirs);
        }
        let finals: [Field; 2] = [|answer| &answer.final_observations, |answer| &answer.reset_info];
        for field in finals {
            let theirs: Vec<u8> = steps
                .iter()
                .flat_map(|step| field(step).as_ref().map_or(vec![], |tensor| tensor.data.to_vec()))
                .collect();
            let ours = field(&answer).as_ref().map_or(vec![], |tensor| tensor.data.to_vec());
            assert_eq!(ours, theirs);
            assert_eq!(!ours.is_empty(), mode == v1::AutoresetMode::SameStep);
        }
        assert!(answer.terminated.as_ref().unwrap().data.contains(&1));
        // And both go on from the same place.
        let next = actions(99, 9);
        assert_eq!(single.step(&next).await.unwrap(), looped.step(&next).await.unwrap());
    }
}

#[tokio::test]
async fn an_open_loop_beyond_the_limits_is_refused_and_takes_no_step() {
    let mut config = palr_gym_server::ServerConfig::default();
    config.limits.max_open_loop_steps = 10;
    config.limits.max_answer_bytes = 10_000;
    let server = TestServer::start(config).await;
    let client = server.client().await;
    let mut session = Session::open(&client, open("hopper", 4)).await.unwrap();
    session.reset(vec![0]).await.unwrap();
    let before = session.snapshot().await.unwrap();
    let reason = "OPEN_LOOP_TOO_LARGE";
    let error = session.step_open_loop(&[0.0; 11 * 12], 11).await.unwrap_err();
    check(&error, Code::InvalidArgument, reason, "11 steps, whose answer has");
    let error = session.step_open_loop(&[0.0; 12 * 12], 12).await.unwrap_err();
    check(&error, Code::InvalidArgument, reason, "expected 1 to 10 steps");
    // 4 environments, (2 * 11 + 3) numbers of 8 bytes and 2 flags each: 808 bytes a step.
    let error = session.step_open_loop(&[0.0; 13 * 12], 13).await.unwrap_err();
    check(&error, Code::InvalidArgument, reason, "10504 bytes");
    let mut bad = [0.0; 6 * 12];
    bad[71] = 1.5;
    let error = session.step_open_loop(&bad, 6).await.unwrap_err();
    check(
        &error,
        Code::InvalidArgument,
        "ACTION_OUT_OF_BOUNDS",
        "environment 3 has 1.5 at index 2",
    );
    for (count, steps) in [(12 * 5, 6), (0, 0), (12 * 6, 5)] {
        let error = session.step_open_loop(&vec![0.0; count], steps).await.unwrap_err();
        check(&error, Code::InvalidArgument, "ACTION_SHAPE", "expected [4, 3]");
    }
    assert_eq!(session.snapshot().await.unwrap(), before);
    session.step_open_loop(&[0.0; 10 * 12], 10).await.unwrap();
}

#[tokio::test]
async fn without_autoreset_an_open_loop_ends_with_the_first_end() {
    let server = TestServer::with_defaults().await;
    let client = server.client().await;
    let disabled = v1::AutoresetMode::Disabled.into();
    let request = v1::OpenSessionRequest { autoreset_mode: disabled, ..open("hopper", 2) };
    let mut session = Session::open(&client, request).await.unwrap();
    session.reset(vec![0]).await.unwrap();
    let row = [1.0, -1.0, 1.0, 0.0, 0.0, 0.0];
    let answer = session.step_open_loop(&row.repeat(100), 100).await.unwrap();
    let terminated = answer.terminated.unwrap();
    let steps = terminated.shape[0] as usize;
    assert!((2..100).contains(&steps));
    assert!(terminated.data[2 * (steps - 1)..].contains(&1));
    assert!(!terminated.data[..2 * (steps - 1)].contains(&1));
    assert_eq!(answer.observations.unwrap().shape, [steps as i64, 2, 11]);
    let error = session.step_open_loop(&row.repeat(2), 2).await.unwrap_err();
    check(&error, Code::FailedPrecondition, "RESET_NEEDED", "environment 0 has ended");
}

#[tokio::test]
async fn float32_observations_are_the_float64_ones_rounded() {
    let server = TestServer::with_defaults().await;
    let client = server.client().await;
    let same_step = v1::AutoresetMode::SameStep.into();
    let wide = v1::OpenSessionRequest { autoreset_mode: same_step, ..open("walker2d-w2", 3) };
    let narrow =
        v1::OpenSessionRequest { observation_dtype: v1::DataType::Float32.into(), ..wide.clone() };
    let mut wide = Session::open(&client, wide).await.unwrap();
    let mut narrow = Session::open(&client, narrow).await.unwrap();
    let dtype = |session: &Session| session.spec().observation_space.as_ref().unwrap().dtype();
    assert_eq!(dtype(&wide), v1::DataType::Float64);
    assert_eq!(dtype(&narrow), v1::DataType::Float32);
    let rounded = |values: Vec<f64>| values.iter().map(|v| *v as f32).collect::<Vec<f32>>();
    let (a, b) = (wide.reset(vec![1]).await.unwrap(), narrow.reset(vec![1]).await.unwrap());
    assert_eq!(rounded(float64(&a.observations)), float32(&b.observations));
    let mut ends = 0;
    for step in 0..60 {
        let row = actions(step, 18);
        let (a, b) = (wide.step(&row).await.unwrap(), narrow.step(&row).await.unwrap());
        assert_eq!(rounded(float64(&a.observations)), float32(&b.observations));
        if a.final_observations.is_some() {
            ends += 1;
            assert_eq!(rounded(float64(&a.final_observations)), float32(&b.final_observations));
        }
        // All else is as it was.
        assert_eq!((a.rewards, a.terminated, a.info), (b.rewards, b.terminated, b.info));
    }
    assert!(ends > 0);
    // A snapshot keeps the type: it goes to a session of its own, and to no other.
    let snapshot = narrow.snapshot().await.unwrap();
    let (opened, state) = Session::from_snapshot(&client, snapshot.clone()).await.unwrap();
    assert_eq!(dtype(&opened), v1::DataType::Float32);
    assert_eq!(float32(&state.observations).len(), 3 * 16);
    let error = wide.restore(snapshot).await.unwrap_err();
    check(&error, Code::InvalidArgument, "SNAPSHOT_MISMATCH", "observation_dtype");
    for wrong in [v1::DataType::Bool.into(), 77] {
        let request = v1::OpenSessionRequest { observation_dtype: wrong, ..open("hopper", 1) };
        let error = Session::open(&client, request).await.err().unwrap();
        check(&error, Code::InvalidArgument, "UNKNOWN_ENUM", "expected FLOAT64 or FLOAT32");
    }
}

#[tokio::test]
async fn a_huge_control_truncates_its_episode_with_the_reason_and_nothing_else() {
    let server = TestServer::with_defaults().await;
    let client = server.client().await;
    let raw = v1::OutOfBounds::Raw.into();
    let request = v1::OpenSessionRequest { out_of_bounds: raw, ..open("hopper", 2) };
    let mut session = Session::open(&client, request).await.unwrap();
    session.reset(vec![0]).await.unwrap();
    let good = session.step(&[0.1; 6]).await.unwrap();
    assert_eq!(good.diverged, []);
    let bad = session.step(&[0.1, 0.1, 0.1, 1e30, 0.1, 0.1]).await.unwrap();
    let expected =
        v1::DivergedEpisode { step: 0, env_index: 1, reason: v1::Divergence::BadControl.into() };
    assert_eq!(bad.diverged, [expected]);
    assert_eq!(bad.truncated.as_ref().unwrap().data[..], [0, 1]);
    assert_eq!(float64(&bad.observations)[11..], float64(&good.observations)[11..]);
    assert_eq!(float64(&bad.rewards)[1], 0.0);
    // The next step resets it, as the end of any episode would.
    let next = session.step(&[0.1; 6]).await.unwrap();
    assert_eq!(next.truncated.unwrap().data[..], [0, 0]);
}
