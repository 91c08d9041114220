use std::collections::BTreeMap;
use std::fs;

use burn::tensor::Device;
use palr_gym_core::random::Generator;

use super::*;
use crate::learning::config::{Algorithm, KfSchedule, KfWeighting, PalrConfig, WeightsMode};
use crate::learning::likelihood;

static GO_ON: AtomicBool = AtomicBool::new(false);

/// A linear expert whose next action follows its past one.
fn data(n: usize) -> TrainingSet {
    let mut generator = Generator::from_seed(31);
    let mut past = [0.0_f32];
    let (mut observations, mut actions, mut past_actions) = (vec![], vec![], vec![]);
    for _ in 0..n {
        let state = generator.standard_normal() as f32;
        let action =
            (0.5 * state + 0.4 * past[0] + 0.2 * generator.standard_normal() as f32).tanh();
        observations.extend([state, past[0]]);
        actions.push(action);
        past_actions.push(past[0]);
        past = [action];
    }
    TrainingSet::new(&observations, 2, actions, past_actions, 1)
        .unwrap()
        .with_episodes(&[n])
        .unwrap()
        .with_frame_stack(2)
        .unwrap()
}

fn config(algorithm: Algorithm, weights: WeightsMode) -> TrainConfig {
    let palr = PalrConfig { weights, pool_size: 3, ..PalrConfig::default() };
    TrainConfig {
        algorithm,
        steps: 9,
        batch: 12,
        seed: 5,
        palr,
        log_every: 4,
        checkpoint_every: 4,
        metric_rows: 16,
        ..TrainConfig::default()
    }
}

/// Every method, and every setting that brings other state or random numbers with it.
fn all_methods() -> Vec<TrainConfig> {
    let mut configs: Vec<TrainConfig> =
        Algorithm::ALL.map(|algorithm| config(algorithm, WeightsMode::Exact)).into();
    configs.push(config(Algorithm::Palr, WeightsMode::Pool));
    configs.push(config(Algorithm::PalrAct, WeightsMode::Pool));
    let exact = |algorithm| config(algorithm, WeightsMode::Exact);
    let mut kf = exact(Algorithm::Kf);
    kf.kf.schedule = KfSchedule::TwoStage;
    kf.kf.weighting = KfWeighting::Step;
    kf.kf.predictor_steps = 3;
    kf.kf.past_actions = 3;
    let mut rap = exact(Algorithm::Rap);
    rap.rap.inner_updates = 2;
    let mut mine = exact(Algorithm::Mine);
    mine.mine.ema_decay = Some(0.9);
    mine.mine.freeze_hidden = true;
    let mut vib = exact(Algorithm::Vib);
    vib.vib.policy_samples = 2;
    configs.extend([kf, rap, mine, vib]);
    configs
}

fn bits(trained: &Trained) -> Vec<u32> {
    trained.policy.parameters.iter().map(|parameter| parameter.to_bits()).collect()
}

/// A run in a folder of its own, uninterrupted.
fn whole(config: &TrainConfig) -> Trained {
    let folder = tempfile::tempdir().unwrap();
    train(config, &data(40), None, folder.path(), false, &GO_ON, |_| ControlFlow::Continue(()))
        .unwrap()
}

#[test]
fn the_same_seed_gives_the_same_bits_and_another_one_others() {
    for config in all_methods() {
        let trained = whole(&config);
        assert!(trained.is_complete && trained.step == 9);
        assert_eq!(bits(&trained), bits(&whole(&config)));
        let other = TrainConfig { seed: 6, ..config.clone() };
        assert_ne!(bits(&trained), bits(&whole(&other)));
        let other = TrainConfig { batch_seed: Some(6), ..config.clone() };
        assert_ne!(bits(&trained), bits(&whole(&other)));
        let same = TrainConfig { batch_seed: Some(config.seed), ..config.clone() };
        assert_eq!(bits(&trained), bits(&whole(&same)));
    }
}

#[test]
fn reports_and_checkpoints_do_not_change_the_bits() {
    for config in all_methods() {
        let trained = whole(&config);
        let busy = TrainConfig { log_every: 1, checkpoint_every: 2, metric_rows: 7, ..config };
        assert_eq!(bits(&trained), bits(&whole(&busy)));
    }
}

#[test]
fn a_run_stopped_by_its_report_and_resumed_gives_the_bits_and_reports_of_a_whole_one() {
    let data = data(40);
    let held_out = data.like(&[0.1, 0.2, -0.3, 0.4], vec![0.1, 0.2], vec![0.0, 0.1]).unwrap();
    for config in all_methods() {
        let config = TrainConfig { log_every: 1, steps: 4, ..config };
        let mut reports = BTreeMap::new();
        let folder = tempfile::tempdir().unwrap();
        let want =
            train(&config, &data, Some(&held_out), folder.path(), false, &GO_ON, |progress| {
                reports.insert(progress.step, format!("{progress:?}"));
                ControlFlow::Continue(())
            })
            .unwrap();
        for stop in [1, 3] {
            let folder = tempfile::tempdir().unwrap();
            let first =
                train(&config, &data, Some(&held_out), folder.path(), false, &GO_ON, |progress| {
                    if progress.step == stop {
                        ControlFlow::Break(())
                    } else {
                        ControlFlow::Continue(())
                    }
                })
                .unwrap();
            assert!(!first.is_complete && first.step == stop);
            assert!(!folder.path().join(ONNX_FILE).exists());
            let got =
                train(&config, &data, Some(&held_out), folder.path(), true, &GO_ON, |progress| {
                    assert_eq!(reports[&progress.step], format!("{progress:?}"));
                    assert!(progress.step > stop);
                    ControlFlow::Continue(())
                })
                .unwrap();
            assert_eq!(bits(&got), bits(&want), "stopped after {stop}");
        }
    }
}

/// Also where there is no report, and within what comes before the first step.
#[test]
fn a_run_that_is_told_to_stop_ends_after_any_step_and_resumes() {
    let data = data(40);
    for config in all_methods() {
        let config = TrainConfig { log_every: 1000, checkpoint_every: 1000, steps: 5, ..config };
        let want = whole(&config);
        let folder = tempfile::tempdir().unwrap();
        let stop = AtomicBool::new(true);
        let mut calls = 0;
        let got = loop {
            let path = folder.path();
            let go_on = |_: &Progress| ControlFlow::Continue(());
            let trained = train(&config, &data, None, path, true, &stop, go_on).unwrap();
            calls += 1;
            if trained.is_complete {
                break trained;
            }
            assert!(path.join(CHECKPOINT_FILE).exists() && trained.step < config.steps);
        };
        let two_stages = config.kf.schedule == KfSchedule::TwoStage;
        let before = if two_stages { config.kf.predictor_steps } else { 0 };
        assert_eq!(calls, config.steps + before);
        assert_eq!(bits(&got), bits(&want), "{:?}", config.algorithm);
    }
}

#[test]
fn numbers_that_are_not_finite_end_the_run_with_their_name_and_keep_the_checkpoint() {
    let data = data(40);
    let go_on = |_: &Progress| ControlFlow::Continue(());
    for config in all_methods() {
        let folder = tempfile::tempdir().unwrap();
        train(&config, &data, None, folder.path(), false, &GO_ON, go_on).unwrap();
        let path = folder.path().join(CHECKPOINT_FILE);
        let fingerprint = data.fingerprint();
        let context = Context::new(&config, &data, SharedWeights::default());
        let fresh = method(context).start();
        let mut state = checkpoint::read(&path, &config, fingerprint, &fresh).unwrap().unwrap();
        let network = state.networks.last_mut().unwrap();
        network.parameters[0] = f32::NAN;
        checkpoint::write(&state, &path, &config, fingerprint).unwrap();
        let before = fs::read(&path).unwrap();
        let longer = TrainConfig { steps: 12, ..config.clone() };
        let error = train(&longer, &data, None, folder.path(), true, &GO_ON, go_on).unwrap_err();
        let TrainError::Diverged { step: 10, tensor, value } = error else {
            panic!("{:?}: {error}", config.algorithm);
        };
        assert!(!tensor.is_empty() && !value.is_finite());
        assert!(fs::read(&path).unwrap() == before, "{:?}", config.algorithm);
    }
}

/// A kill leaves the folder as it was at some moment: with an older checkpoint, and perhaps with
/// one that was only begun.
#[test]
fn a_run_killed_between_checkpoints_gives_the_bits_of_a_whole_one() {
    let data = data(40);
    let config = config(Algorithm::Palr, WeightsMode::Pool);
    let want = whole(&config);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(CHECKPOINT_FILE);
    let go_on = |_: &Progress| ControlFlow::Continue(());
    // Killed before the first checkpoint.
    fs::write(folder.path().join("checkpoint.safetensors.writing"), b"torn").unwrap();
    let mut killed = None;
    train(&config, &data, None, folder.path(), true, &GO_ON, |progress| {
        // At step 8 the checkpoint of step 4 is the last.
        if progress.step == 8 {
            killed = fs::read(&path).ok();
        }
        ControlFlow::Continue(())
    })
    .unwrap();
    fs::write(&path, killed.unwrap()).unwrap();
    let got = train(&config, &data, None, folder.path(), true, &GO_ON, go_on).unwrap();
    assert_eq!(bits(&got), bits(&want));
    // Finished runs resume to what they are, and shorter ones go on.
    let again = train(&config, &data, None, folder.path(), true, &GO_ON, go_on).unwrap();
    assert!(again.is_complete && bits(&again) == bits(&want));
    let longer = TrainConfig { steps: 11, ..config.clone() };
    let longer_here = train(&longer, &data, None, folder.path(), true, &GO_ON, go_on).unwrap();
    assert_eq!(bits(&longer_here), bits(&whole(&longer)));
    let error = train(&config, &data, None, folder.path(), true, &GO_ON, go_on).unwrap_err();
    assert!(error.to_string().contains("has 11 steps already; steps is 9"), "{error}");
    let error = train(&config, &data, None, folder.path(), false, &GO_ON, go_on).unwrap_err();
    assert!(error.to_string().contains("there is a run already; resume it"), "{error}");
}

#[test]
fn a_finished_run_leaves_settings_checkpoint_and_policy() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(Algorithm::Bc, WeightsMode::Exact);
    let go_on = |_: &Progress| ControlFlow::Continue(());
    let trained = train(&config, &data(40), None, folder.path(), false, &GO_ON, go_on).unwrap();
    let mut names: Vec<_> = fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort_unstable();
    assert_eq!(names, [CHECKPOINT_FILE, CONFIG_FILE, ONNX_FILE, SAFETENSORS_FILE]);
    let text = fs::read(folder.path().join(CONFIG_FILE)).unwrap();
    let read = TrainConfig::from_json(serde_json::from_slice(&text).unwrap()).unwrap();
    assert_eq!(read, config);
    let onnx = fs::read(folder.path().join(ONNX_FILE)).unwrap();
    assert_eq!(onnx, trained.policy.to_onnx().unwrap());
}

#[test]
fn held_out_data_of_another_size_and_a_diverging_run_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let go_on = |_: &Progress| ControlFlow::Continue(());
    let config = config(Algorithm::Bc, WeightsMode::Exact);
    let other = TrainingSet::new(&[0.0; 6], 3, vec![0.0; 2], vec![0.0; 2], 1).unwrap();
    let error =
        train(&config, &data(40), Some(&other), folder.path(), false, &GO_ON, go_on).unwrap_err();
    assert_eq!(error.to_string(), "an observation has size 3; expected 2");
    let wild = TrainConfig { learning_rate: 1e30, ..config };
    let error = train(&wild, &data(40), None, folder.path(), false, &GO_ON, go_on).unwrap_err();
    assert!(matches!(error, TrainError::Diverged { .. }), "{error}");
    let message = error.to_string();
    assert!(message.contains(" at step 2; the last checkpoint is kept"), "{message}");
    assert!(!folder.path().join(CHECKPOINT_FILE).exists());
}

/// u = 0.8 x + 0.3 e: the best likelihood is the noise's own, and known.
#[test]
fn behaviour_cloning_reaches_the_known_optimum_of_a_linear_expert() {
    let expert = |seed: u64, n: usize| {
        let mut generator = Generator::from_seed(seed);
        let mut rows = (vec![], vec![], 0.0);
        for _ in 0..n {
            let (x, e) = (generator.standard_normal(), generator.standard_normal());
            let u = 0.8 * x + 0.3 * e;
            rows.0.push(x as f32);
            rows.1.push(u.tanh() as f32);
            let slope = (1.0 - u.tanh().powi(2)).ln();
            let half_log_tau = 0.5 * std::f64::consts::TAU.ln();
            rows.2 += (0.5 * e * e + 0.3_f64.ln() + half_log_tau + slope) / n as f64;
        }
        rows
    };
    let (observations, actions, _) = expert(1, 2000);
    let zeros = vec![0.0; 2000];
    let data = TrainingSet::new(&observations, 1, actions, zeros.clone(), 1).unwrap();
    let (observations, actions, best) = expert(2, 2000);
    let held_out = data.like(&observations, actions, zeros).unwrap();
    let config = TrainConfig {
        algorithm: Algorithm::Bc,
        steps: 300,
        batch: 64,
        learning_rate: 2e-3,
        log_every: 300,
        metric_rows: 256,
        ..TrainConfig::default()
    };
    let folder = tempfile::tempdir().unwrap();
    let go_on = |_: &Progress| ControlFlow::Continue(());
    let trained =
        train(&config, &data, Some(&held_out), folder.path(), false, &GO_ON, go_on).unwrap();
    let batch = held_out.batch(&(0..2000).collect::<Vec<_>>()).tensors(&Device::flex());
    let TrainedPolicy { architecture, parameters, .. } = trained.policy;
    let output =
        architecture.forward(&parameters, batch.observations.clone(), &Device::flex()).unwrap();
    let (_, nll) = likelihood::of_batch(&output, &batch).unwrap();
    // In nats; a policy that ignores the observation is 1.0 worse.
    assert!((nll - best).abs() < 0.05, "{nll} {best}");
}

/// The observation holds the past action itself, so that a representation leaks it unless it is
/// kept from it.
#[test]
fn palr_learns_a_representation_that_leaks_less_than_that_of_behaviour_cloning() {
    let data = data(1000);
    for weights in [WeightsMode::Exact, WeightsMode::Pool] {
        let [plain, regularized] = [Algorithm::Bc, Algorithm::Palr].map(|algorithm| {
            let palr = PalrConfig { weights, pool_size: 8, alpha: 100.0, ..PalrConfig::default() };
            let config = TrainConfig {
                algorithm,
                steps: 100,
                batch: 48,
                learning_rate: 2e-3,
                metric_rows: 128,
                palr,
                ..TrainConfig::default()
            };
            let folder = tempfile::tempdir().unwrap();
            let mut last = None;
            train(&config, &data, None, folder.path(), false, &GO_ON, |progress| {
                last = Some(progress.training);
                ControlFlow::Continue(())
            })
            .unwrap();
            last.unwrap()
        });
        let (bc, palr) = (plain.hscic, regularized.hscic);
        assert!(palr > -1e-6 && palr < 0.5 * bc, "{weights:?}: {palr} against {bc}");
        // Not by forgetting everything: without the observation it would be a nat worse.
        let (bc, palr) = (plain.nll, regularized.nll);
        assert!(palr < bc + 0.2, "{weights:?}: {palr} against {bc} nats");
    }
}
