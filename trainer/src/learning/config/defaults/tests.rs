use std::collections::BTreeSet;

use super::*;
use crate::learning::config::{KfWeighting, WeightsMode};

/// Table 8 of the paper: setting, then KF (none: the step function), FCA, MINE, PALR.
const TABLE_8: [(&str, Option<f64>, f64, f64, f64); 9] = [
    ("hopper-w2", Some(0.01), 0.1, 1.0, 10.0),
    ("hopper-w4", Some(0.01), 0.1, 0.01, 10.0),
    ("walker2d-w2", Some(0.01), 0.1, 1.0, 100.0),
    ("walker2d-w4", Some(0.1), 0.1, 1.0, 100.0),
    ("halfcheetah-w2", Some(0.01), 0.1, 1.0, 10.0),
    ("halfcheetah-w4", Some(0.1), 0.1, 0.1, 10.0),
    ("ant-w2", Some(1.0), 0.1, 0.01, 10.0),
    ("ant-w4", Some(0.01), 1.0, 0.01, 10.0),
    ("lane-w3", None, 0.001, 10.0, 1000.0),
];

/// Our own setting, which the paper has not.
const TOY: &str = "toy-w2";

/// The tables say nothing of DT.
fn tabled() -> impl Iterator<Item = Algorithm> {
    let is_dt = |algorithm: &Algorithm| [Algorithm::Dt, Algorithm::DtPalr].contains(algorithm);
    Algorithm::ALL.into_iter().filter(move |algorithm| !is_dt(algorithm))
}

#[test]
fn the_tuned_settings_are_those_of_the_papers_table_8() {
    for (setting, kf, fca, mine, palr) in TABLE_8 {
        for env_id in [setting.to_owned(), format!("{setting}-v0")] {
            let of = |algorithm| defaults(algorithm, &env_id).unwrap();
            let got = of(Algorithm::Kf).kf;
            match kf {
                Some(temperature) => assert_eq!(got.temperature, temperature, "{setting}"),
                None => {
                    assert_eq!((got.step_share, got.step_weight), (0.1, 5.0));
                }
            }
            assert_eq!(got.weighting == KfWeighting::Step, kf.is_none(), "{setting}");
            assert_eq!(of(Algorithm::Fca).fca.alpha, fca, "{setting}");
            assert_eq!(of(Algorithm::Mine).mine.alpha, mine, "{setting}");
            assert_eq!(of(Algorithm::Palr).palr.alpha, palr, "{setting}");
            let steps = if setting == "lane-w3" { 1_000_000 } else { 500_000 };
            assert!(tabled().all(|algorithm| of(algorithm).steps == steps));
        }
    }
}

#[test]
fn the_common_settings_are_those_of_the_papers_table_7() {
    for (setting, ..) in TABLE_8 {
        for algorithm in tabled() {
            let config = defaults(algorithm, setting).unwrap();
            assert_eq!(config.algorithm, algorithm);
            assert_eq!((config.batch, config.learning_rate), (1024, 3e-4));
            assert_eq!((config.palr.bandwidth_sq, config.palr.ridge), (1.0, 1e-5));
            assert_eq!(config.palr.weights, WeightsMode::Exact);
            let TrainConfig { kf, primenet, rap, fca, mine, .. } = config;
            assert_eq!((kf.hidden_sizes, kf.inner_updates, kf.learning_rate), ([128; 2], 1, 3e-4));
            assert_eq!(primenet.learning_rate, 3e-4);
            let got = (rap.residual_size, rap.inner_updates, rap.learning_rate);
            assert_eq!(got, (300, 1, 3e-4));
            let got = (fca.hidden_size, fca.inner_updates, fca.learning_rate, fca.bottleneck);
            assert_eq!(got, (300, 5, 1e-4, 0.01));
            let got = (mine.hidden_sizes, mine.inner_updates, mine.learning_rate);
            assert_eq!(got, ([100; 2], 5, 1e-4));
        }
    }
}

#[test]
fn every_file_names_all_settings_of_its_method_and_only_known_tasks() {
    let all = serde_json::to_value(TrainConfig::default()).unwrap();
    for algorithm in Algorithm::ALL {
        let file: MethodFile = toml::from_str(text(algorithm)).unwrap();
        let name = algorithm.name();
        if let Some(table) = all.get(name) {
            // TOML has no null: what is unset cannot be named.
            let want = table.as_object().unwrap().iter().filter(|(_, value)| !value.is_null());
            let want: BTreeSet<&String> = want.map(|(key, _)| key).collect();
            let got: BTreeSet<&String> = file.default[name].as_object().unwrap().keys().collect();
            assert_eq!(got, want, "{name}");
        }
        for (key, settings) in &file.settings {
            let is_known = key == TOY || TABLE_8.iter().any(|(setting, ..)| setting == key);
            assert!(is_known, "{name}: {key}");
            assert_ne!(settings, &Value::Object(Map::new()), "{name}: {key}");
        }
    }
}

#[test]
fn other_tasks_masks_and_stacks_have_the_general_settings() {
    let general = defaults(Algorithm::Palr, "walker2d-w3").unwrap();
    assert_eq!(general.palr.alpha, 10.0);
    for env_id in ["walker2d", "walker2d-strict-w2", "xyzzy-w2", "", "walker2d-w0"] {
        assert_eq!(defaults(Algorithm::Palr, env_id).unwrap(), general, "{env_id}");
    }
}
