//! The copycat and its cure on the toy task, from demonstrations to scores.
//!
//! The truth is the task's own: its goal, its cue and its demonstrator are simple enough for their
//! optimum to be written down.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use palr_gym_core::ActionMode;
use palr_gym_proto::v1::collect_request::Amount;
use palr_gym_trainer::collect::{CollectOptions, Existing, collect};
use palr_gym_trainer::evaluate::{EvaluateOptions, evaluate};
use palr_gym_trainer::imitate::data::{Prepared, prepare};
use palr_gym_trainer::imitate::settings::Settings;
use palr_gym_trainer::learning::train::ONNX_FILE;
use palr_gym_trainer::learning::{TrainConfig, Trained, TrainingSet, train};
use palr_gym_trainer::{Client, PolicySource};
use serde_json::{Value, json};

use crate::support::TestServer;

const ENV_ID: &str = "toy-w2";
/// Demonstrated steps to train on.
const ROWS: u64 = 20_000;

/// What is known of the task (`crates/palr-gym-sim/src/tasks/toy.rs`) and of its demonstrator
/// (`scenes/experts/README.md`).
const CHANGE: f64 = 0.02;
const RIGHT: f64 = 0.9;
const EPISODE: f64 = 400.0;
const DEMONSTRATOR_MEAN: f64 = 3.5;
const DEMONSTRATOR_STD: f64 = 1.0;

/// Demonstrations in `file`; each `seed` has its own.
async fn demonstrate(client: &Client, file: &Path, seed: u64) {
    let options = CollectOptions {
        env_id: "toy".into(),
        policy: PolicySource::Expert,
        amount: Amount::Transitions(ROWS),
        seed: 1_000_000 * (seed + 1),
        action_mode: ActionMode::Sampled,
        num_envs: None,
        scene_options: None,
        out: file.to_path_buf(),
        existing: Existing::Keep,
    };
    collect(client, &options, |_| {}).await.unwrap();
}

/// The shipped settings of the method that `layer` names, with the rest of `layer` over them.
fn settings(file: &Path, layer: Value) -> Settings {
    // Reports are not looked at here, and their M of 1024 rows takes longer than the training.
    let base = json!({
        "env": ENV_ID, "data": file, "training_rows": ROWS, "held_out": { "rows": 0 },
        "metric_rows": 16,
    });
    Settings::from_layers(&[base, layer]).unwrap()
}

async fn learn(config: TrainConfig, prepared: Prepared, folder: &Path) -> Trained {
    let folder = folder.to_path_buf();
    let run = move || {
        let never = AtomicBool::new(false);
        let go_on = |_: &_| ControlFlow::Continue(());
        train(&config, &prepared.training, None, &folder, false, &never, go_on).unwrap()
    };
    tokio::task::spawn_blocking(run).await.unwrap()
}

/// Mean and half of the 95 % interval of five scores.
fn interval(scores: &[f64]) -> (f64, f64) {
    /// Student's t with four degrees of freedom.
    const T: f64 = 2.776;
    let n = scores.len() as f64;
    assert!(n == 5.0);
    let mean = scores.iter().sum::<f64>() / n;
    let variance = scores.iter().map(|score| (score - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, T * (variance / n).sqrt())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn behaviour_cloning_is_a_copycat_and_palr_is_none() {
    let server = TestServer::with_defaults().await;
    let client = server.client().await;
    let folder = tempfile::tempdir().unwrap();
    let mut scores = [vec![], vec![]];
    for seed in 0..5_u64 {
        let file = folder.path().join(format!("{seed}.hdf5"));
        demonstrate(&client, &file, seed).await;
        for (scores, method) in scores.iter_mut().zip(["bc", "palr"]) {
            let settings = settings(&file, json!({ "algorithm": method, "seed": seed }));
            let run_folder = folder.path().join(format!("{method}-{seed}"));
            std::fs::create_dir(&run_folder).unwrap();
            let prepared = prepare(&client, &settings).await.unwrap();
            learn(settings.train, prepared, &run_folder).await;
            let options = EvaluateOptions {
                env_id: ENV_ID.into(),
                policy: PolicySource::File(run_folder.join(ONNX_FILE)),
                episodes: 20,
                seed: 0,
                action_mode: ActionMode::Deterministic,
                num_envs: None,
                scene_options: None,
            };
            // 0 is chance, 100 the best that a policy of the cues can do.
            scores.push(evaluate(&client, &options, |_| {}).await.unwrap().score_mean);
        }
    }
    let [(bc, bc_half), (palr, palr_half)] = scores.each_ref().map(|scores| interval(scores));
    assert!(bc <= 50.0 && palr >= 80.0, "BC {:.1?}, PALR {:.1?}", scores[0], scores[1]);
    assert!(bc + bc_half < palr - palr_half, "{bc} ± {bc_half}, {palr} ± {palr_half}");
}

/// What the past goal's side, if there is one, and the cue tell of u = atanh of the demonstrator's
/// action: the best Gaussian, as mean and variance. With the past side, nothing older tells of the
/// goal, whose side has a probability p here; u is ±[`DEMONSTRATOR_MEAN`] with noise, and the best
/// Gaussian has u's mean and variance.
fn best_gaussian(past: f64, cue: f64) -> (f64, f64) {
    let likelihood = |goal: f64| if cue == goal { RIGHT } else { 1.0 - RIGHT };
    let prior = |goal: f64| match past {
        0.0 => 0.5,
        past if past == goal => 1.0 - CHANGE,
        _ => CHANGE,
    };
    let [plus, minus] = [1.0, -1.0].map(|goal| prior(goal) * likelihood(goal));
    let p = plus / (plus + minus);
    let sides = (2.0 * DEMONSTRATOR_MEAN).powi(2) * p * (1.0 - p);
    (DEMONSTRATOR_MEAN * (2.0 * p - 1.0), DEMONSTRATOR_STD.powi(2) + sides)
}

/// The least mean of -log p(u), in nats, that a Gaussian of the observations can have: the entropy of
/// [`best_gaussian`], averaged over the cases. The past side is unknown in an episode's first step.
fn least_nll() -> f64 {
    let entropy = |past: f64, cue: f64| {
        let (_, variance) = best_gaussian(past, cue);
        0.5 * (std::f64::consts::TAU * std::f64::consts::E * variance).ln()
    };
    let agree = (1.0 - CHANGE) * RIGHT + CHANGE * (1.0 - RIGHT);
    let later = agree * entropy(1.0, 1.0) + (1.0 - agree) * entropy(1.0, -1.0);
    (entropy(0.0, 1.0) + (EPISODE - 1.0) * later) / EPISODE
}

/// Of each row, -log p(u) under the policy and under [`best_gaussian`], in nats.
fn nlls(trained: &Trained, set: &TrainingSet) -> (Vec<f64>, Vec<f64>) {
    let rows: Vec<usize> = (0..set.len()).collect();
    let batch = set.batch(&rows);
    let statistics = set.observation_statistics();
    let columns = statistics.mean.iter().zip(&statistics.std).cycle();
    let raw: Vec<f32> =
        batch.observations.iter().zip(columns).map(|(x, (mean, std))| x * std + mean).collect();
    let output = trained.policy.act(&raw).unwrap();
    let row = |i: usize| {
        let u = f64::from(batch.actions[i]).clamp(-0.999_999, 0.999_999).atanh();
        let nll = |mean: f64, variance: f64| {
            0.5 * ((u - mean).powi(2) / variance + (std::f64::consts::TAU * variance).ln())
        };
        let std = f64::from(output.log_std[i]).exp();
        // Two frames of position and cue. A position of 0 is an episode's first.
        let [.., position, cue] = raw[4 * i..4 * (i + 1)] else { unreachable!() };
        let past = if position.abs() < 1e-3 { 0.0 } else { f64::from(position.signum()) };
        let (mean, variance) = best_gaussian(past, f64::from(cue.signum()));
        (nll(f64::from(output.mean[i]), std * std), nll(mean, variance))
    };
    rows.iter().copied().map(row).unzip()
}

/// Mean and its standard error.
fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / n;
    (mean, (variance / n).sqrt())
}

/// Trains a method, with `layer` over its shipped settings, and compares with the optimum.
async fn reaches_the_optimum(method: &str, layer: Value) {
    let server = TestServer::with_defaults().await;
    let client = server.client().await;
    let folder = tempfile::tempdir().unwrap();
    let mut sets = Vec::new();
    let common = json!({ "algorithm": method, "steps": 400, "batch": 128, "learning_rate": 1e-3 });
    for seed in 0..2 {
        let file = folder.path().join(format!("{seed}.hdf5"));
        demonstrate(&client, &file, seed).await;
        let base = settings(&file, common.clone()).to_json();
        let settings = Settings::from_layers(&[base, layer.clone()]).unwrap();
        let prepared = prepare(&client, &settings).await.unwrap();
        sets.push((settings.train, prepared));
    }
    let [(config, training), (_, fresh)] = sets.try_into().ok().unwrap();
    let trained = learn(config, training, folder.path()).await;
    let (got, best) = nlls(&trained, &fresh.training);
    let (best, error) = mean_and_error(&best);
    let (got, _) = mean_and_error(&got);
    let want = least_nll();
    assert!((best - want).abs() < 5.0 * error, "{best} {want} {error}");
    // On the same rows. A policy that knows only the cue is 0.6 nats away, one that knows only the
    // past action 0.17.
    assert!(got > best - 0.01 && got < best + 0.05, "{got} {best}");
}

macro_rules! reach_the_optimum {
    ($($name:ident: $layer:tt;)*) => {$(
        #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
        async fn $name() {
            reaches_the_optimum(stringify!($name), json!($layer)).await;
        }
    )*};
}

/// On fresh demonstrations, each method's likelihood is the best there is. Regularisers are on, but
/// weigh too little to move it.
mod every_method_drives_its_likelihood_to_the_optimum {
    use super::*;

    reach_the_optimum! {
        bc: {};
        kf: { "kf": { "temperature": 0.01 } };
        primenet: {};
        rap: {};
        fca: { "fca": { "alpha": 1e-3, "bottleneck": 1e-7, "inner_updates": 1 } };
        mine: { "mine": { "alpha": 1e-3, "inner_updates": 1 } };
        palr: { "palr": { "alpha": 1.0 } };
        palr_act: { "palr": { "alpha": 1.0 } };
        vib: { "vib": { "beta": 1e-5 } };
        dt: { "steps": 150, "batch": 64, "dt": { "warmup_steps": 20 } };
        dt_palr: {
            "steps": 150, "batch": 64, "dt": { "warmup_steps": 20 }, "palr": { "alpha": 1.0 },
        };
    }
}
