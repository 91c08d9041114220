//! `palr-gym train`

use std::io::Write;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;
use indicatif::ProgressBar;
use palr_gym_trainer::imitate::{DataConfig, Prepared, imitate, prepare};
use palr_gym_trainer::learning::{Algorithm, Progress, TrainConfig, WeightsMode};
use palr_gym_trainer::runs::Run;
use serde::Serialize;

use crate::cli::{AlgorithmName, TrainArguments, WeightsName};
use crate::{backend, output, progress};

const CONFIG: &str = "train.json";
const DATA: &str = "data.json";
const METRICS: &str = "metrics.jsonl";
/// Held-out rows come from at least so many episodes, so that they say something about more than
/// one.
const HELD_OUT_EPISODES: usize = 20;

/// What a run came to.
#[derive(Serialize)]
struct Report {
    run_folder: PathBuf,
    is_complete: bool,
    step: u64,
    /// There once the run is complete.
    policy: Option<PathBuf>,
    last: Option<Metrics>,
}

/// One line of `metrics.jsonl`.
#[derive(Debug, Clone, Serialize)]
struct Metrics {
    step: u64,
    batch_nll: f64,
    batch_hscic: Option<f64>,
    training_nll: f64,
    training_hscic: f64,
    held_out_nll: Option<f64>,
    held_out_hscic: Option<f64>,
}

impl From<&Progress> for Metrics {
    fn from(progress: &Progress) -> Self {
        let held_out = progress.held_out.as_ref();
        Self {
            step: progress.step,
            batch_nll: progress.batch_nll,
            batch_hscic: progress.batch_hscic,
            training_nll: progress.training.nll,
            training_hscic: progress.training.hscic,
            held_out_nll: held_out.map(|measured| measured.nll),
            held_out_hscic: held_out.map(|measured| measured.hscic),
        }
    }
}

/// Trains and says where the policy is.
pub async fn run(arguments: TrainArguments) -> anyhow::Result<()> {
    let settings = Settings::from_arguments(&arguments)?;
    let client = backend::connect(&arguments.server).await?;
    // What is wrong with the data is found before a folder is made.
    let prepared = match &settings.fresh {
        Some((_, data)) => Some(prepare(&client, data).await?),
        None => None,
    };
    let (run, config, data) = settings.open(&arguments.out)?;
    let prepared = match prepared {
        Some(prepared) => prepared,
        None => prepare(&client, &data).await?,
    };
    let is_interrupted = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&is_interrupted);
    tokio::spawn(async move {
        if tokio::signal::ctrl_c().await.is_ok() {
            flag.store(true, Ordering::Relaxed);
        }
    });
    let bar = progress::bar("train", config.steps, "steps");
    let shown = bar.clone();
    let report = tokio::task::spawn_blocking(move || {
        learn(&run, &config, &prepared, arguments.resume, &is_interrupted, &shown)
    })
    .await
    .context("the trainer panicked")?;
    bar.finish_and_clear();
    let report = report?;
    if arguments.json {
        return output::json(&report);
    }
    let folder = report.run_folder.display();
    match (&report.policy, &report.last) {
        (Some(policy), Some(last)) => println!(
            "{}: {} steps, likelihood {:.4} nats (held out {})",
            policy.display(),
            report.step,
            -last.training_nll,
            last.held_out_nll.map_or_else(|| "not measured".into(), |nll| format!("{:.4}", -nll)),
        ),
        (Some(policy), None) => println!("{}: was complete already", policy.display()),
        _ => println!("{folder}: stopped at step {}; --resume goes on", report.step),
    }
    Ok(())
}

/// What to do: fresh settings, or those of the run that is resumed.
struct Settings {
    fresh: Option<(TrainConfig, DataConfig)>,
}

impl Settings {
    fn from_arguments(arguments: &TrainArguments) -> anyhow::Result<Self> {
        let (Some(env_id), Some(data), false) = (&arguments.env, &arguments.data, arguments.resume)
        else {
            return Ok(Self { fresh: None });
        };
        let mut config = TrainConfig {
            algorithm: match arguments.algorithm {
                AlgorithmName::Bc => Algorithm::Bc,
                AlgorithmName::Palr => Algorithm::Palr,
            },
            steps: arguments.steps,
            batch: arguments.batch,
            seed: arguments.seed,
            log_every: arguments.log_every,
            ..TrainConfig::default()
        };
        config.palr.alpha = arguments.alpha;
        config.palr.weights = match arguments.weights {
            WeightsName::Exact => WeightsMode::Exact,
            WeightsName::Pool => WeightsMode::Pool,
        };
        config.validate().map_err(palr_gym_trainer::ClientError::from)?;
        let data = DataConfig {
            env_id: env_id.clone(),
            data: std::path::absolute(data)?,
            training_rows: arguments.training_rows,
            held_out_rows: arguments.held_out_rows,
            held_out_episodes: HELD_OUT_EPISODES,
        };
        Ok(Self { fresh: Some((config, data)) })
    }

    fn open(self, out: &Path) -> anyhow::Result<(Run, TrainConfig, DataConfig)> {
        if let Some((config, data)) = self.fresh {
            let run = Run::create(out)?;
            run.write_json(CONFIG, &config)?;
            run.write_json(DATA, &data)?;
            return Ok((run, config, data));
        }
        let run = Run::open_latest(out)?;
        let folder = run.folder().display().to_string();
        let began = || format!("{folder} was interrupted before it began; start a new run");
        let config: serde_json::Value = run.read_json(CONFIG)?.with_context(began)?;
        let config = TrainConfig::from_json(config).map_err(palr_gym_trainer::ClientError::from)?;
        let data = run.read_json(DATA)?.with_context(began)?;
        Ok((run, config, data))
    }
}

fn learn(
    run: &Run,
    config: &TrainConfig,
    prepared: &Prepared,
    resume: bool,
    is_interrupted: &AtomicBool,
    bar: &ProgressBar,
) -> anyhow::Result<Report> {
    let mut metrics =
        std::fs::OpenOptions::new().create(true).append(true).open(run.path(METRICS))?;
    let mut last = None;
    let mut failed = None;
    let trained = imitate(run, config, prepared, resume, |progress| {
        let line = Metrics::from(progress);
        bar.set_position(progress.step);
        bar.set_message(format!(
            "· nll {:.4}, hscic {:.2e}",
            line.training_nll, line.training_hscic
        ));
        let written = serde_json::to_string(&line)
            .map_err(anyhow::Error::from)
            .and_then(|text| Ok(writeln!(metrics, "{text}")?));
        last = Some(line);
        failed = written.err();
        if failed.is_some() || is_interrupted.load(Ordering::Relaxed) {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    })?;
    if let Some(error) = failed {
        return Err(error.context(format!("cannot write {}", run.path(METRICS).display())));
    }
    Ok(Report {
        run_folder: run.folder().to_path_buf(),
        is_complete: trained.is_complete,
        step: trained.step,
        policy: trained.is_complete.then(|| run.path("policy.onnx")),
        last,
    })
}
