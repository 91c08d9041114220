//! Snapshots over the wire.

use bytes::Bytes;
use palr_gym_proto::v1;
use palr_gym_trainer::error::ClientError;
use palr_gym_trainer::session::Session;
use tonic::Code;

use crate::support::{TestServer, open};

fn actions(step: usize, count: usize) -> Vec<f32> {
    (0..count).map(|i| (((step * 31 + i * 7) % 21) as f32 - 10.0) / 10.0).collect()
}

async fn play(session: &mut Session, from: usize, count: usize) -> Vec<v1::StepResponse> {
    let row = session.spec().action_space.as_ref().unwrap().names.len() * session.num_envs();
    let mut answers = Vec::new();
    for step in from..from + count {
        answers.push(session.step(&actions(step, row)).await.unwrap());
    }
    answers
}

/// NaN in infos is no number, so answers are compared as text.
#[track_caller]
fn assert_same(left: &[v1::StepResponse], right: &[v1::StepResponse]) {
    assert_eq!(format!("{left:?}"), format!("{right:?}"));
}

#[tokio::test]
async fn restored_opened_and_forked_sessions_go_on_as_the_original_did() {
    let server = TestServer::with_defaults().await;
    let other_server = TestServer::with_defaults().await;
    let (client, other) = (server.client().await, other_server.client().await);
    for env_id in ["hopper-w2", "ant-gym5"] {
        let mut session = Session::open(&client, open(env_id, 3)).await.unwrap();
        session.reset(vec![5]).await.unwrap();
        play(&mut session, 0, 25).await;
        let snapshot = session.snapshot().await.unwrap();
        let (mut forked, state) = session.fork().await.unwrap();
        let expected = play(&mut session, 25, 40).await;

        assert_same(&play(&mut forked, 25, 40).await, &expected);
        let restored = session.restore(snapshot.clone()).await.unwrap();
        assert_eq!(restored, state);
        assert!(restored.was_reset);
        assert_eq!(restored.is_over.as_ref().unwrap().shape, [3]);
        assert_same(&play(&mut session, 25, 40).await, &expected);
        // On a server that never saw the original.
        let (mut moved, state) = Session::from_snapshot(&other, snapshot).await.unwrap();
        assert_eq!(state, restored);
        assert_eq!((moved.spec(), moved.num_envs()), (session.spec(), 3));
        assert_same(&play(&mut moved, 25, 40).await, &expected);
    }
}

#[track_caller]
fn check(error: &ClientError, expected_reason: &str, text: &str) {
    let ClientError::Status { code, reason, message } = error else { panic!("{error}") };
    let expected = (Code::InvalidArgument, Some(expected_reason));
    assert_eq!((*code, reason.as_deref()), expected, "{message}");
    assert!(message.contains(text), "{message}");
}

#[tokio::test]
async fn what_is_no_snapshot_is_refused_and_changes_nothing() {
    let server = TestServer::with_defaults().await;
    let client = server.client().await;
    let mut session = Session::open(&client, open("hopper", 2)).await.unwrap();
    session.reset(vec![5]).await.unwrap();
    let good = session.snapshot().await.unwrap();
    let changed = |at: usize| {
        let mut bytes = good.to_vec();
        bytes[at] ^= 1;
        Bytes::from(bytes)
    };
    for (bytes, text) in [
        (Bytes::new(), "these 0 bytes are no snapshot"),
        (Bytes::from_static(b"PNG"), "these 3 bytes are no snapshot"),
        (changed(0), "are no snapshot"),
        (changed(8), "version 5; this build reads version 4"),
        (changed(12), "checksum"),
        (changed(good.len() - 1), "checksum"),
        (good.slice(..good.len() - 1), "checksum"),
        (good.slice(..10), "version is cut off"),
    ] {
        check(&session.restore(bytes.clone()).await.unwrap_err(), "INVALID_SNAPSHOT", text);
        let error = Session::from_snapshot(&client, bytes).await.err().unwrap();
        check(&error, "INVALID_SNAPSHOT", text);
    }
    let mut other = Session::open(&client, open("hopper", 3)).await.unwrap();
    let error = other.restore(good.clone()).await.unwrap_err();
    check(&error, "SNAPSHOT_MISMATCH", "num_envs is 2; expected 3");
    assert_eq!(session.snapshot().await.unwrap(), good);
}

#[tokio::test]
async fn limits_hold_for_snapshots_and_forks() {
    // Room for one environment, not for two.
    let one = {
        let server = TestServer::with_defaults().await;
        let session = Session::open(&server.client().await, open("hopper", 1)).await.unwrap();
        session.snapshot().await.unwrap().len()
    };
    let mut config = palr_gym_server::ServerConfig::default();
    config.limits.max_snapshot_bytes = one + 1;
    config.limits.max_envs = 4;
    let server = TestServer::start(config).await;
    let client = server.client().await;
    let small = Session::open(&client, open("hopper", 1)).await.unwrap();
    small.snapshot().await.unwrap();
    let large = Session::open(&client, open("hopper", 2)).await.unwrap();
    for error in [large.snapshot().await.unwrap_err(), large.fork().await.err().unwrap()] {
        let ClientError::Status { code, reason, message } = &error else { panic!("{error}") };
        let expected = (Code::FailedPrecondition, Some("SNAPSHOT_TOO_LARGE"));
        assert_eq!((*code, reason.as_deref()), expected, "{message}");
    }
    let (_fork, _) = small.fork().await.unwrap();
    let error = small.fork().await.err().unwrap();
    let ClientError::Status { code, reason, .. } = &error else { panic!("{error}") };
    assert_eq!((*code, reason.as_deref()), (Code::ResourceExhausted, Some("TOO_MANY_ENVS")));
    // A snapshot of a session that was never reset opens one that was not, either.
    let (mut opened, state) = {
        let snapshot = small.snapshot().await.unwrap();
        large.close().await.unwrap();
        Session::from_snapshot(&client, snapshot).await.unwrap()
    };
    assert!(!state.was_reset);
    assert!(opened.step(&[0.0; 3]).await.unwrap_err().to_string().contains("never reset"));
}
