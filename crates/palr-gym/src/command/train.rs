//! `palr-gym train`

use std::path::{Path, PathBuf};
use std::sync::Arc;

use palr_gym_core::{ActionMode, EnvId};
use palr_gym_proto::v1::collect_request::Amount;
use palr_gym_trainer::collect::{CollectOptions, Existing};
use palr_gym_trainer::imitate::settings::{
    Settings, algorithm, layer_from_assignment, layer_from_toml, merge, nest, refuse_unknown,
};
use palr_gym_trainer::imitate::{Imitation, Outcome};
use palr_gym_trainer::learning::TrainError;
use palr_gym_trainer::runs::Run;
use palr_gym_trainer::{Client, ClientError, PolicySource};
use serde_json::Value;
use tokio::sync::mpsc::unbounded_channel;

use super::collect;
use crate::cli::TrainArguments;
use crate::interrupt::{Interrupted, stop_on_signals};
use crate::watch::Watch;
use crate::{backend, build, output};

/// Recorded when a run names no data: the paper's 30 000 rows, and 20 episodes to hold out.
const DEFAULT_TRANSITIONS: u64 = 55_000;

/// Trains and says where the policy is.
pub async fn run(arguments: TrainArguments) -> anyhow::Result<()> {
    let mut layers = Vec::new();
    for path in &arguments.config {
        let text = std::fs::read_to_string(path).map_err(|error| ClientError::file(path, error))?;
        let layer = layer_from_toml(&text).map_err(|error| named(path, error))?;
        refuse_unknown(&layer).map_err(|error| named(path, error))?;
        layers.push(layer);
    }
    layers.extend(arguments.flag_layers());
    if let Some(alpha) = arguments.alpha {
        layers.push(alpha_layer(&layers, alpha)?);
    }
    for assignment in &arguments.set {
        layers.push(layer_from_assignment(assignment)?);
    }
    // A run can be resumed from anywhere.
    for layer in &mut layers {
        if let Some(Value::String(data)) = layer.get_mut("data") {
            *data = std::path::absolute(&*data)?.to_string_lossy().into_owned();
        }
    }
    let is_fresh = arguments.resume.is_none();
    let default_data = if is_fresh { default_data(&layers, &arguments.out)? } else { None };
    if let Some(data) = &default_data {
        layers.insert(0, nest("data", data.path.to_string_lossy().into()));
    }
    if is_fresh {
        // What is wrong with the settings is found before anything else happens.
        let settings = Settings::from_layers(&layers)?;
        if arguments.print_config {
            print!("{}", settings.to_toml()?);
            return Ok(());
        }
    }
    let client = backend::connect(&arguments.server).await?;
    let imitation = match &arguments.resume {
        None => {
            if let Some(data) = &default_data {
                data.record(&client).await?;
            }
            let settings = Settings::from_layers(&layers)?;
            Imitation::start(&client, &arguments.out, settings, build::GIT_REVISION).await?
        }
        Some(folder) => {
            let run = match folder {
                Some(folder) => Run::open(folder)?,
                None => Run::open_latest(&arguments.out)?,
            };
            let over = |mut stored: Value| {
                for layer in &layers {
                    merge(&mut stored, layer);
                }
                Settings::from_layers(&[stored])
            };
            if arguments.print_config {
                let manifest = palr_gym_trainer::imitate::manifest::Manifest::read(run.folder())?;
                print!("{}", over(manifest.settings)?.to_toml()?);
                return Ok(());
            }
            Imitation::resume(&client, run, over).await?
        }
    };
    let outcome = learn(&client, imitation, arguments.json).await?;
    report(&outcome, arguments.json)
}

/// α is a setting of its own in each method.
fn alpha_layer(layers: &[Value], alpha: f64) -> anyhow::Result<Value> {
    let named = layers.iter().rev().find(|layer| layer.get("algorithm").is_some());
    let algorithm = algorithm(named.unwrap_or(&Value::Null))?;
    let Some(setting) = algorithm.alpha_setting() else {
        let message = format!("{} has no α; leave --alpha away", algorithm.name());
        return Err(ClientError::from(TrainError::Setting { message }).into());
    };
    Ok(nest(setting, alpha.into()))
}

async fn learn(client: &Client, imitation: Imitation, is_quiet: bool) -> anyhow::Result<Outcome> {
    let is_stopped = stop_on_signals();
    let settings = imitation.settings();
    let label = settings.train.algorithm.name().to_owned();
    let watch = Watch::new(&label, settings.train.steps, is_quiet);
    if !is_quiet {
        eprintln!("run folder {}", imitation.folder().display());
    }
    let (sender, receiver) = unbounded_channel();
    let watching = tokio::spawn(watch.follow(receiver));
    let outcome = imitation.run(client, Arc::clone(&is_stopped), sender).await;
    // It ends with the run; what it showed does not matter any more.
    let _ = watching.await;
    Ok(outcome?)
}

fn report(outcome: &Outcome, is_json: bool) -> anyhow::Result<()> {
    if is_json {
        output::json(outcome)?;
    }
    let folder = outcome.run_folder.display();
    if !outcome.is_complete {
        return Err(Interrupted {
            message: format!(
                "stopped at step {}; `palr-gym train --resume {folder}` goes on",
                outcome.step
            ),
        }
        .into());
    }
    if is_json {
        return Ok(());
    }
    match &outcome.last {
        Some(last) => {
            let held_out = last.held_out_nll.map(|nll| format!(", held out {:.4}", -nll));
            let held_out = held_out.unwrap_or_default();
            let likelihood = -last.training_nll;
            println!("{folder}: {} steps, log-likelihood {likelihood:.4}{held_out}", outcome.step);
        }
        None => println!("{folder}: was complete already, {} steps", outcome.step),
    }
    if let Some(evaluation) = &outcome.evaluation {
        println!(
            "{folder}: score {:.1}{} over {} episodes at step {}",
            evaluation.score_mean,
            evaluation.score_standard_error.map(|se| format!(" ± {se:.1}")).unwrap_or_default(),
            evaluation.episodes,
            evaluation.step,
        );
    }
    Ok(())
}

/// The recording of a run that names none.
struct DefaultData {
    task: String,
    path: PathBuf,
}

/// Which recording a run gets that names an environment but no data.
fn default_data(layers: &[Value], out: &Path) -> anyhow::Result<Option<DefaultData>> {
    let text = |key: &str| layers.iter().rev().find_map(|layer| layer.get(key)?.as_str());
    let (None, Some(env)) = (text("data"), text("env")) else { return Ok(None) };
    // An id that cannot be read is refused by the server, with the nearest one.
    let Ok(env_id) = env.parse::<EnvId>() else { return Ok(None) };
    let folder = out.parent().unwrap_or(Path::new("")).join("data");
    let name = format!("{}-expert-sampled-{DEFAULT_TRANSITIONS}.hdf5", env_id.task);
    let path = std::path::absolute(folder.join(name))?;
    Ok(Some(DefaultData { task: env_id.task, path }))
}

impl DefaultData {
    /// Records it, goes on with it, or leaves it as it is.
    async fn record(&self, client: &Client) -> anyhow::Result<()> {
        if let Some(folder) = self.path.parent() {
            std::fs::create_dir_all(folder).map_err(|error| ClientError::file(folder, error))?;
        }
        let options = CollectOptions {
            env_id: self.task.clone(),
            policy: PolicySource::Expert,
            amount: Amount::Transitions(DEFAULT_TRANSITIONS),
            seed: 0,
            action_mode: ActionMode::Sampled,
            num_envs: None,
            out: self.path.clone(),
            existing: Existing::Resume,
        };
        collect::with_progress(client, &options).await?;
        Ok(())
    }
}

fn named(path: &Path, error: ClientError) -> ClientError {
    ClientError::Settings { path: path.into(), cause: Box::new(error) }
}
