use palr_gym_core::random::Generator;

use super::*;
use crate::learning::config::{Algorithm, PalrConfig};
use crate::learning::train::{CHECKPOINT_FILE, ONNX_FILE, train};

static GO_ON: AtomicBool = AtomicBool::new(false);
const N: usize = 40;

/// The same actions seen with `stack` numbers each.
fn data(stack: usize) -> TrainingSet {
    let mut generator = Generator::from_seed(8);
    let actions: Vec<f32> = (0..=N).map(|_| generator.standard_normal().tanh() as f32).collect();
    let observations: Vec<f32> = (0..N * stack)
        .map(|i| actions[i / stack] + 0.3 * generator.standard_normal() as f32)
        .collect();
    let past = actions[..N].to_vec();
    TrainingSet::new(&observations, stack, actions[1..].to_vec(), past, 1).unwrap()
}

fn config(algorithm: Algorithm, seed: u64, alpha: f64) -> TrainConfig {
    TrainConfig {
        algorithm,
        seed,
        batch_seed: Some(77),
        steps: 5,
        batch: 12,
        log_every: 2,
        checkpoint_every: 2,
        metric_rows: 8,
        palr: PalrConfig { alpha, ..PalrConfig::default() },
        ..TrainConfig::default()
    }
}

fn bits(trained: &Trained) -> Vec<u32> {
    trained.policy.parameters.iter().map(|parameter| parameter.to_bits()).collect()
}

#[test]
fn a_run_in_lockstep_has_the_bits_that_it_has_alone() {
    let sets = [data(1), data(2)];
    let configs = [
        config(Algorithm::Palr, 0, 1.0),
        config(Algorithm::Palr, 1, 1.0),
        config(Algorithm::Palr, 0, 100.0),
        config(Algorithm::PalrAct, 0, 1.0),
        config(Algorithm::Bc, 0, 1.0),
    ];
    let folder = tempfile::tempdir().unwrap();
    let jobs: Vec<(&TrainConfig, &TrainingSet, std::path::PathBuf)> = configs
        .iter()
        .flat_map(|config| sets.iter().map(move |data| (config, data)))
        .enumerate()
        .map(|(i, (config, data))| (config, data, folder.path().join(i.to_string())))
        .collect();
    let runs: Vec<LockstepRun<'_>> = jobs
        .iter()
        .map(|(config, data, path)| {
            std::fs::create_dir(path).unwrap();
            LockstepRun { config, data, held_out: None, run_folder: path }
        })
        .collect();

    // Stopped once in the middle of a round, then resumed: runs are at different steps.
    let stop = |place: usize, progress: &Progress| match (place, progress.step) {
        (3, 2) => ControlFlow::Break(()),
        _ => ControlFlow::Continue(()),
    };
    let stopped = train_lockstep(&runs, false, &GO_ON, stop).unwrap();
    let steps: Vec<u64> = stopped.iter().map(|trained| trained.step).collect();
    assert_eq!(steps, [2, 2, 2, 2, 1, 1, 1, 1, 1, 1]);
    assert!(runs.iter().all(|run| run.run_folder.join(CHECKPOINT_FILE).exists()));

    let mut reports = vec![Vec::new(); runs.len()];
    let together = train_lockstep(&runs, true, &GO_ON, |place, progress| {
        reports[place].push(progress.step);
        ControlFlow::Continue(())
    })
    .unwrap();
    assert_eq!((&reports[0], &reports[9]), (&vec![4, 5], &vec![2, 4, 5]));
    for (trained, (config, data, path)) in together.iter().zip(&jobs) {
        assert!(trained.is_complete && path.join(ONNX_FILE).exists());
        let alone = tempfile::tempdir().unwrap();
        let go_on = |_: &Progress| ControlFlow::Continue(());
        let want = train(config, data, None, alone.path(), false, &GO_ON, go_on).unwrap();
        assert_eq!(bits(trained), bits(&want));
    }
    assert_ne!(bits(&together[0]), bits(&together[2]));
    assert_ne!(bits(&together[0]), bits(&together[4]));
}

#[test]
fn a_run_that_fails_among_others_is_named_and_the_others_keep_their_steps() {
    let data = data(1);
    let folder = tempfile::tempdir().unwrap();
    let folders = ["a", "b"].map(|name| folder.path().join(name));
    // Steps so large that nothing stays finite.
    let configs = [1e-3, 1e38]
        .map(|learning_rate| TrainConfig { learning_rate, ..config(Algorithm::Bc, 0, 1.0) });
    let runs: Vec<LockstepRun<'_>> = folders
        .iter()
        .zip(&configs)
        .map(|(run_folder, config)| {
            std::fs::create_dir(run_folder).unwrap();
            LockstepRun { config, data: &data, held_out: None, run_folder }
        })
        .collect();
    let go_on = |_: usize, _: &Progress| ControlFlow::Continue(());
    let error = train_lockstep(&runs, false, &GO_ON, go_on).unwrap_err();
    let TrainError::OneOfMany { run_folder, cause } = &error else { panic!("{error}") };
    assert_eq!(run_folder, &folders[1]);
    assert!(matches!(**cause, TrainError::Diverged { .. }), "{cause}");
    assert!(error.to_string().starts_with(&format!("run {}: ", folders[1].display())));
    assert!(folders[0].join(CHECKPOINT_FILE).exists());
    // Alone, it need not be told apart.
    let alone = train_lockstep(&runs[1..], true, &GO_ON, go_on).unwrap_err();
    assert_eq!(alone.to_string(), cause.to_string());
}

#[test]
fn runs_that_draw_other_batches_or_share_a_folder_are_refused() {
    let data = data(1);
    let folder = tempfile::tempdir().unwrap();
    let own = config(Algorithm::Bc, 0, 1.0);
    let refusal = |other: &TrainConfig, name: &str| {
        let other_folder = folder.path().join(name);
        let run =
            LockstepRun { config: &own, data: &data, held_out: None, run_folder: folder.path() };
        let runs = [run, LockstepRun { config: other, run_folder: &other_folder, ..run }];
        let go_on = |_: usize, _: &Progress| ControlFlow::Continue(());
        train_lockstep(&runs, false, &GO_ON, go_on).unwrap_err().to_string()
    };
    let other = TrainConfig { batch_seed: None, ..own.clone() };
    assert!(refusal(&other, "b").starts_with("batch_seed is 0 in one run and 77 in another"));
    let other = TrainConfig { batch: 13, ..own.clone() };
    assert!(refusal(&other, "b").starts_with("batch is 13 in one run"));
    assert!(refusal(&own, "").contains("is the folder of two runs"));
}
