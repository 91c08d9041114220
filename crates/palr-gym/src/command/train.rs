//! `palr-gym train`

mod choice;
mod grid;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use indicatif::MultiProgress;
use palr_gym_core::{ActionMode, EnvId};
use palr_gym_proto::v1::collect_request::Amount;
use palr_gym_trainer::collect::{CollectOptions, Existing};
use palr_gym_trainer::imitate::choice::Choice;
use palr_gym_trainer::imitate::data::Shelf;
use palr_gym_trainer::imitate::manifest::Manifest;
use palr_gym_trainer::imitate::settings::{
    Settings, layer_from_assignment, layer_from_toml, merge, nest, refuse_unknown,
};
use palr_gym_trainer::imitate::together::run_together;
use palr_gym_trainer::imitate::{Imitation, Outcome};
use palr_gym_trainer::learning::TrainError;
use palr_gym_trainer::runs::Run;
use palr_gym_trainer::{Client, ClientError, PolicySource};
use serde_json::{Value, json};
use tokio::sync::mpsc::unbounded_channel;

use self::grid::Layers;
use super::collect;
use crate::cli::TrainArguments;
use crate::interrupt::{Interrupted, stop_on_signals};
use crate::watch::Watch;
use crate::{backend, build, output};

/// Recorded when a run names no data: the paper's 30 000 rows, and 20 episodes to hold out.
const DEFAULT_TRANSITIONS: u64 = 55_000;

/// Trains and says where the policies are.
pub async fn run(arguments: TrainArguments) -> anyhow::Result<()> {
    let mut layers = layers(&arguments)?;
    if let Some(folders) = &arguments.resume {
        return resume(&arguments, &layers, folders).await;
    }
    let default_data = default_data(&layers, &arguments.out)?;
    if let Some(data) = &default_data {
        layers.below.insert(0, nest("data", data.path.to_string_lossy().into()));
    }
    // What is wrong with the settings is found before anything else happens.
    let settings = grid::settings(&arguments, &layers)?;
    if arguments.print_config {
        for settings in &settings {
            print!("{}", settings.to_toml()?);
        }
        return Ok(());
    }
    let is_auto = arguments.alpha.as_ref().is_some_and(|alphas| alphas.is_auto);
    if is_auto && settings.iter().any(|settings| settings.run.held_out.rows == 0) {
        let message = "held_out.rows is 0; --alpha auto chooses by held-out rows".to_owned();
        return Err(ClientError::from(TrainError::Setting { message }).into());
    }
    let client = backend::connect(&arguments.server).await?;
    if let Some(data) = &default_data {
        data.record(&client).await?;
    }
    let revision = build::GIT_REVISION;
    let runs = Imitation::start_all(&client, &arguments.out, settings, revision).await?;
    let outcomes = learn(&client, runs, arguments.json).await?;
    let choices = match is_auto && outcomes.iter().all(|outcome| outcome.is_complete) {
        true => Some(choice::of_runs(&outcomes, &arguments.out)?),
        false => None,
    };
    report(&outcomes, choices.as_deref(), arguments.json)
}

/// Goes on with the runs in `folders`, or with the newest.
async fn resume(
    arguments: &TrainArguments,
    layers: &Layers,
    folders: &[PathBuf],
) -> anyhow::Result<()> {
    let mut layers: Vec<Value> = layers.all().cloned().collect();
    match arguments.alpha.as_ref().map(|alphas| (alphas.values.as_slice(), alphas.is_auto)) {
        None => {}
        Some((&[alpha], false)) => {
            let named = Layers { below: layers.clone(), above: Vec::new() };
            layers.push(grid::alpha_layer(&named, alpha)?);
        }
        Some(_) => {
            let message = "a run that goes on keeps its α; leave --alpha away".to_owned();
            return Err(ClientError::from(TrainError::Setting { message }).into());
        }
    }
    let runs: Result<Vec<Run>, ClientError> = match folders {
        [] => Run::open_latest(&arguments.out).map(|run| vec![run]),
        folders => folders.iter().map(|folder| Run::open(folder)).collect(),
    };
    let over = |mut stored: Value| {
        for layer in &layers {
            merge(&mut stored, layer);
        }
        Settings::from_layers(&[stored])
    };
    let runs = runs?;
    if arguments.print_config {
        for run in runs {
            print!("{}", over(Manifest::read(run.folder())?.settings)?.to_toml()?);
        }
        return Ok(());
    }
    let client = backend::connect(&arguments.server).await?;
    let mut shelf = Shelf::default();
    let mut imitations = Vec::with_capacity(runs.len());
    for run in runs {
        imitations.push(Imitation::resume_sharing(&client, run, &mut shelf, over).await?);
    }
    let outcomes = learn(&client, imitations, arguments.json).await?;
    report(&outcomes, None, arguments.json)
}

/// What files and flags say, without what makes several runs.
fn layers(arguments: &TrainArguments) -> anyhow::Result<Layers> {
    let mut below = Vec::new();
    for path in &arguments.config {
        let text = std::fs::read_to_string(path).map_err(|error| ClientError::file(path, error))?;
        let layer = layer_from_toml(&text).map_err(|error| named(path, error))?;
        refuse_unknown(&layer).map_err(|error| named(path, error))?;
        below.push(layer);
    }
    below.extend(arguments.flag_layers());
    let above: Result<Vec<Value>, ClientError> =
        arguments.set.iter().map(|assignment| layer_from_assignment(assignment)).collect();
    let mut above = above?;
    // A run can be resumed from anywhere.
    for layer in below.iter_mut().chain(&mut above) {
        if let Some(Value::String(data)) = layer.get_mut("data") {
            *data = std::path::absolute(&*data)?.to_string_lossy().into_owned();
        }
    }
    Ok(Layers { below, above })
}

async fn learn(
    client: &Client,
    runs: Vec<Imitation>,
    is_quiet: bool,
) -> anyhow::Result<Vec<Outcome>> {
    let is_stopped = stop_on_signals();
    let bars = MultiProgress::new();
    let (mut senders, mut watching) = (Vec::new(), Vec::new());
    for imitation in &runs {
        let settings = imitation.settings();
        let algorithm = settings.train.algorithm.name();
        let label = match imitation.folder().file_name() {
            Some(name) if runs.len() > 1 => format!("{} {algorithm}", name.to_string_lossy()),
            _ => algorithm.to_owned(),
        };
        let watch = Watch::new(&label, settings.train.steps, is_quiet);
        if !is_quiet {
            eprintln!("run folder {}", imitation.folder().display());
        }
        let (sender, receiver) = unbounded_channel();
        senders.push(sender);
        watching.push(tokio::spawn(watch.among(&bars).follow(receiver)));
    }
    let outcomes = run_together(runs, client, Arc::clone(&is_stopped), senders).await;
    for watching in watching {
        // It ends with the run; what it showed does not matter any more.
        let _ = watching.await;
    }
    Ok(outcomes?)
}

fn report(outcomes: &[Outcome], choices: Option<&[Choice]>, is_json: bool) -> anyhow::Result<()> {
    match (outcomes, choices) {
        _ if !is_json => {}
        ([outcome], None) => output::json(outcome)?,
        (outcomes, None) => output::json(&outcomes)?,
        (outcomes, Some(choices)) => output::json(&json!({"runs": outcomes, "choices": choices}))?,
    }
    let unfinished: Vec<&Outcome> =
        outcomes.iter().filter(|outcome| !outcome.is_complete).collect();
    if let Some(step) = unfinished.iter().map(|outcome| outcome.step).min() {
        let folders: Vec<String> =
            unfinished.iter().map(|outcome| outcome.run_folder.display().to_string()).collect();
        let folders = folders.join(" ");
        return Err(Interrupted {
            message: format!("stopped at step {step}; `palr-gym train --resume {folders}` goes on"),
        }
        .into());
    }
    if !is_json {
        outcomes.iter().for_each(print);
        choices.unwrap_or_default().iter().for_each(choice::print);
    }
    Ok(())
}

fn print(outcome: &Outcome) {
    let folder = outcome.run_folder.display();
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
}

/// The recording of a run that names none.
struct DefaultData {
    task: String,
    path: PathBuf,
}

/// Which recording a run gets that names an environment but no data.
fn default_data(layers: &Layers, out: &Path) -> anyhow::Result<Option<DefaultData>> {
    let (None, Some(env)) = (layers.text("data"), layers.text("env")) else { return Ok(None) };
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
            scene_options: None,
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
