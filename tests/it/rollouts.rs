//! Evaluation and collection through the client.

use std::path::Path;

use palr_gym_proto::v1;
use palr_gym_proto::v1::collect_request::Amount;
use palr_gym_trainer::PolicySource;
use palr_gym_trainer::collect::{CollectOptions, Existing, collect, journal_path};
use palr_gym_trainer::evaluate::{EvaluateOptions, evaluate};

use crate::support::TestServer;

fn evaluation(policy: PolicySource, episodes: u32) -> EvaluateOptions {
    EvaluateOptions {
        env_id: "hopper".into(),
        policy,
        episodes,
        seed: 7,
        action_mode: Default::default(),
        num_envs: None,
        scene_options: None,
    }
}

fn collection(out: &Path, existing: Existing) -> CollectOptions {
    CollectOptions {
        env_id: "hopper".into(),
        policy: PolicySource::Random,
        amount: Amount::Transitions(700),
        seed: 5,
        action_mode: Default::default(),
        num_envs: Some(4),
        scene_options: None,
        out: out.to_path_buf(),
        existing,
    }
}

#[tokio::test]
async fn an_episode_depends_on_its_seed_and_not_on_how_many_are_played() {
    let server = TestServer::with_defaults().await;
    let client = server.client().await;
    for policy in [PolicySource::Random, PolicySource::Expert] {
        let few = evaluate(&client, &evaluation(policy.clone(), 2), |_| {}).await.unwrap();
        let many = evaluate(&client, &evaluation(policy, 5), |_| {}).await.unwrap();
        assert_eq!(few.episodes, many.episodes[..2]);
        assert_ne!(many.episodes[0].episode_return, many.episodes[1].episode_return);
    }
}

#[tokio::test]
async fn the_expert_is_an_expert_and_chance_is_not() {
    let server = TestServer::with_defaults().await;
    let client = server.client().await;
    let expert = evaluate(&client, &evaluation(PolicySource::Expert, 4), |_| {}).await.unwrap();
    assert!(expert.score_mean > 95.0, "{}", expert.score_mean);
    assert_eq!(expert.steps, expert.episodes.iter().map(|e| u64::from(e.length)).sum::<u64>());
    let random = evaluate(&client, &evaluation(PolicySource::Random, 20), |_| {}).await.unwrap();
    assert!(random.score_mean.abs() < 3.0, "{}", random.score_mean);
}

#[tokio::test]
async fn an_interrupted_recording_resumes_to_the_same_bytes() {
    let server = TestServer::with_defaults().await;
    let client = server.client().await;
    let folder = tempfile::tempdir().unwrap();
    let (whole, resumed) = (folder.path().join("whole.hdf5"), folder.path().join("resumed.hdf5"));
    let mut journals = Vec::new();
    let part = journal_path(&whole);
    collect(&client, &collection(&whole, Existing::Keep), |_| {
        journals.push(std::fs::read(&part).unwrap());
    })
    .await
    .unwrap();
    assert!(!part.exists());
    let expected = std::fs::read(&whole).unwrap();
    // Cut short in the header, between episodes, in the middle of one, and after the last.
    let third = &journals[2];
    let last = journals.last().unwrap();
    for bytes in [&third[..12], third, &third[..third.len() - 100], last] {
        std::fs::write(journal_path(&resumed), bytes).unwrap();
        let refused = collect(&client, &collection(&resumed, Existing::Keep), |_| {}).await;
        assert!(refused.unwrap_err().to_string().contains("--resume"));
        collect(&client, &collection(&resumed, Existing::Resume), |_| {}).await.unwrap();
        assert!(std::fs::read(&resumed).unwrap() == expected);
        std::fs::remove_file(&resumed).unwrap();
    }
}

#[tokio::test]
async fn recordings_of_different_things_are_never_joined() {
    let server = TestServer::with_defaults().await;
    let client = server.client().await;
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.hdf5");
    collect(&client, &collection(&out, Existing::Keep), |_| {}).await.unwrap();
    let before = std::fs::read(&out).unwrap();
    let kept = collect(&client, &collection(&out, Existing::Keep), |_| {}).await.unwrap_err();
    assert!(kept.to_string().contains("exists already"), "{kept}");
    let other = CollectOptions { seed: 6, ..collection(&out, Existing::Resume) };
    let refused = collect(&client, &other, |_| {}).await.unwrap_err();
    assert!(refused.to_string().contains("seed = 5, not 6"), "{refused}");
    assert!(std::fs::read(&out).unwrap() == before);
    let same = collect(&client, &collection(&out, Existing::Resume), |_| {}).await.unwrap();
    assert!(same.was_complete);
}

#[tokio::test]
async fn scene_options_reach_rollouts_and_are_recorded() {
    let server = TestServer::with_defaults().await;
    let client = server.client().await;
    let with = |options: v1::SceneOptions| EvaluateOptions {
        env_id: "lane".into(),
        scene_options: Some(options),
        ..evaluation(PolicySource::Expert, 3)
    };
    let led = |probability| v1::SceneOptions {
        lead_car_probability: Some(probability),
        ..v1::SceneOptions::default()
    };
    let free = evaluate(&client, &with(led(0.0)), |_| {}).await.unwrap();
    let behind = evaluate(&client, &with(led(1.0)), |_| {}).await.unwrap();
    // Nobody cruises behind a car that stops and goes.
    assert!(free.return_mean > behind.return_mean + 50.0, "{free:?} {behind:?}");
    let random = v1::SceneOptions { weather: v1::Weather::Random.into(), ..led(0.0) };
    assert_eq!(evaluate(&client, &with(random), |_| {}).await.unwrap().episodes, free.episodes);

    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("lane.hdf5");
    let record = |options, existing| CollectOptions {
        env_id: "lane".into(),
        policy: PolicySource::Expert,
        amount: Amount::Transitions(100),
        scene_options: options,
        ..collection(&out, existing)
    };
    collect(&client, &record(Some(led(0.0)), Existing::Keep), |_| {}).await.unwrap();
    for other in [None, Some(led(1.0))] {
        let refused = collect(&client, &record(other, Existing::Resume), |_| {}).await.unwrap_err();
        let recorded = r#"scene_options = {"weather":null,"lead_car_probability":0.0,"#;
        assert!(refused.to_string().contains(recorded), "{refused}");
    }
    let same = collect(&client, &record(Some(led(0.0)), Existing::Resume), |_| {}).await.unwrap();
    assert!(same.was_complete);
}
