//! `palr-gym expert`

mod imitate;
mod plot;

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::Context;
use indicatif::ProgressBar;
use palr_gym_trainer::PolicySource;
use palr_gym_trainer::expert::card::{CARD_FILE, Card, measure};
use palr_gym_trainer::expert::fitness::{FOLDER, FitnessOptions, Imitated};
use palr_gym_trainer::expert::run::ONNX_FILE;
use palr_gym_trainer::expert::{Event, ExpertRun, ExpertSettings, Outcome};
use palr_gym_trainer::learning::TrainError;
use palr_gym_trainer::learning::config::from_json;
use palr_gym_trainer::{Client, ClientError};
use serde_json::Value;
use tokio::sync::mpsc::{UnboundedReceiver, unbounded_channel};

use crate::cli::expert::{
    ExpertArguments, ExpertCardArguments, ExpertCommand, ExpertTrainArguments,
};
use crate::interrupt::{Interrupted, stop_on_signals};
use crate::{backend, build, output, progress};

/// Does what is asked about experts.
pub async fn run(arguments: ExpertArguments) -> anyhow::Result<()> {
    match arguments.command {
        ExpertCommand::Train(arguments) => train(arguments).await,
        ExpertCommand::Card(arguments) => card(arguments).await,
        ExpertCommand::Imitate(arguments) => imitate::run(arguments).await,
        ExpertCommand::Plot(arguments) => plot::run(&arguments),
    }
}

async fn train(arguments: ExpertTrainArguments) -> anyhow::Result<()> {
    let folder = match &arguments.out {
        Some(folder) => folder.clone(),
        None => state_home()?.join("palr-gym/experts").join(&arguments.env),
    };
    let settings = |stored: Option<ExpertSettings>| {
        let base = stored.unwrap_or_else(|| ExpertSettings::for_task(&arguments.env));
        changed(&base, &arguments)
    };
    if arguments.print_config && !arguments.resume && arguments.from.is_none() {
        print!("{}", toml(&settings(None)?)?);
        return Ok(());
    }
    // An environment that does not exist is found before a folder is made for it.
    let client = backend::connect(&arguments.server).await?;
    client.spec(&arguments.env).await?;
    let expert = if arguments.resume {
        ExpertRun::resume(&folder, settings)?
    } else {
        settings(None)?.validate().map_err(ClientError::from)?;
        ExpertRun::start(&folder, arguments.from.as_deref(), settings)?
    };
    if arguments.print_config {
        print!("{}", toml(expert.settings())?);
        return Ok(());
    }
    let is_quiet = arguments.json;
    if !is_quiet {
        eprintln!("run folder {}", folder.display());
    }
    let is_stopped = stop_on_signals();
    let (sender, receiver) = unbounded_channel();
    let watching = tokio::spawn(watch(expert.settings().clone(), is_quiet, receiver));
    let outcome = expert.train(&client, build::GIT_REVISION, Arc::clone(&is_stopped), sender).await;
    // It ends with the run; what it showed does not matter any more.
    let _ = watching.await;
    report(&client, outcome?, arguments.card_episodes, is_quiet).await
}

async fn report(
    client: &Client,
    outcome: Outcome,
    card_episodes: u32,
    is_json: bool,
) -> anyhow::Result<()> {
    let folder = outcome.run_folder.display();
    if !outcome.is_complete {
        if is_json {
            output::json(&outcome)?;
        }
        let message = format!(
            "stopped at step {}, update {}; the same command with --resume goes on",
            outcome.counters.step, outcome.updates
        );
        return Err(Interrupted { message }.into());
    }
    if is_json && card_episodes == 0 {
        return output::json(&outcome);
    }
    if !is_json {
        println!("{folder}: {} steps, {} updates", outcome.counters.step, outcome.updates);
    }
    if card_episodes == 0 {
        return Ok(());
    }
    let card = write_card(client, &outcome.run_folder, card_episodes).await?;
    if is_json {
        return output::json(&card);
    }
    print_card(&outcome.run_folder, &card);
    Ok(())
}

async fn card(arguments: ExpertCardArguments) -> anyhow::Result<()> {
    let client = backend::connect(&arguments.server).await?;
    let (folder, episodes) = (&arguments.folder, arguments.episodes);
    let mut card = write_card(&client, folder, episodes).await?;
    if arguments.imitate {
        let options = FitnessOptions {
            transitions: FitnessOptions::TRANSITIONS,
            steps: arguments.imitation_steps,
            episodes,
        };
        let imitated = Imitated {
            env: card.env.clone(),
            policy: PolicySource::File(folder.join(ONNX_FILE)),
            onnx_sha256: card.onnx.sha256.clone(),
            reached: card.deterministic.clone(),
        };
        let count = (arguments.imitators, arguments.json);
        let home = folder.join(FOLDER);
        card.fitness = Some(imitate::fitness(&client, &imitated, &home, options, count).await?);
        save_card(folder, &card)?;
    }
    if arguments.json {
        return output::json(&card);
    }
    print_card(folder, &card);
    Ok(())
}

async fn write_card(client: &Client, folder: &Path, episodes: u32) -> anyhow::Result<Card> {
    let card = measure(client, folder, episodes).await?;
    save_card(folder, &card)?;
    Ok(card)
}

fn save_card(folder: &Path, card: &Card) -> anyhow::Result<()> {
    let path = folder.join(CARD_FILE);
    let text = serde_json::to_string_pretty(card)? + "\n";
    Ok(std::fs::write(&path, text).map_err(|error| ClientError::file(&path, error))?)
}

fn print_card(folder: &Path, card: &Card) {
    for (name, measured) in [("mean action", &card.deterministic), ("sampled", &card.sampled)] {
        println!(
            "{}: {name}: return {:.1}{}, score {:.1}, lowest return {:.1}, {} episodes",
            folder.display(),
            measured.return_mean,
            measured.return_standard_error.map(|se| format!(" ± {se:.1}")).unwrap_or_default(),
            measured.score_mean,
            measured.return_min,
            measured.episodes,
        );
    }
    if let Some(fitness) = &card.fitness {
        println!("{}: {}", folder.display(), imitate::sentence(fitness));
    }
}

/// `settings` with what the flags and then each --set say.
fn changed(
    settings: &ExpertSettings,
    arguments: &ExpertTrainArguments,
) -> Result<ExpertSettings, ClientError> {
    let refused = |message: String| ClientError::from(TrainError::Setting { message });
    let mut value = serde_json::to_value(settings).map_err(|error| refused(error.to_string()))?;
    let mut put = |name: &str, new: Value| {
        let fields = value.as_object_mut();
        match fields.and_then(|fields| fields.get_mut(name)) {
            Some(field) => {
                *field = new;
                Ok(())
            }
            None => Err(ClientError::from(TrainError::UnknownSetting {
                name: name.to_owned(),
                nearest: None,
            })),
        }
    };
    for (name, new) in arguments.flags() {
        put(name, new)?;
    }
    for assignment in &arguments.set {
        let (name, text) = assignment
            .split_once('=')
            .ok_or_else(|| refused(format!("{assignment:?} is no setting; expected KEY=VALUE")))?;
        let new = serde_json::from_str(text).unwrap_or_else(|_| Value::String(text.to_owned()));
        put(name, new)?;
    }
    Ok(from_json(value)?)
}

fn toml(settings: &ExpertSettings) -> anyhow::Result<String> {
    Ok(palr_gym_trainer::expert::settings::to_toml(settings)?)
}

/// Where programs keep what should outlive a reboot but is no document.
fn state_home() -> anyhow::Result<PathBuf> {
    let absolute =
        |name| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    match absolute("XDG_STATE_HOME") {
        Some(path) => Ok(path),
        None => Ok(absolute("HOME")
            .context("HOME is not set; name a folder with --out")?
            .join(".local/state")),
    }
}

/// Shows what comes until the run ends: a bar on a terminal, lines elsewhere.
async fn watch(settings: ExpertSettings, is_quiet: bool, mut events: UnboundedReceiver<Event>) {
    let bar: ProgressBar = progress::bar(&settings.env, settings.steps, "steps");
    let has_lines = !is_quiet && !std::io::stderr().is_terminal();
    let mut score = String::new();
    let mut pace = Pace::default();
    let mut refilled = 0;
    while let Some(event) = events.recv().await {
        match event {
            Event::Refill(now, all) => {
                bar.set_message(format!("· collecting anew {now}/{all}"));
                if has_lines && (refilled == 0 || now >= all) {
                    eprintln!("{:>12} collecting anew {now}/{all}", settings.env);
                }
                refilled = now;
            }
            Event::Report(metrics) => {
                let training = metrics
                    .training_return
                    .map_or_else(String::new, |value| format!(" · training return {value:.0}"));
                let text = format!(
                    "· {} updates{training} · α {:.3}{score}",
                    metrics.updates, metrics.temperature
                );
                bar.set_position(metrics.step);
                if has_lines {
                    let left = pace.left(metrics.step, metrics.wall_time_s, settings.steps);
                    eprintln!(
                        "{:>12} {:>8}/{} {text}{left}",
                        settings.env, metrics.step, settings.steps
                    );
                }
                bar.set_message(text);
            }
            Event::Evaluation(record) => {
                if has_lines {
                    eprintln!(
                        "{:>12} {:>8}/{} · evaluated: return {:.1}, score {:.1}, length {:.0}",
                        settings.env,
                        record.step,
                        settings.steps,
                        record.return_mean,
                        record.score_mean,
                        record.length_mean
                    );
                }
                score = format!(" · score {:.1}", record.score_mean);
            }
        }
    }
    bar.finish_and_clear();
}

/// How fast steps come, from the newest two reports.
#[derive(Default)]
struct Pace {
    last: Option<(u64, f64)>,
}

impl Pace {
    fn left(&mut self, step: u64, wall_time_s: f64, steps: u64) -> String {
        let last = self.last.replace((step, wall_time_s));
        let Some((last_step, last_wall_time_s)) = last.filter(|last| last.0 < step) else {
            return String::new();
        };
        let per_step = (wall_time_s - last_wall_time_s) / (step - last_step) as f64;
        let minutes = (per_step * steps.saturating_sub(step) as f64 / 60.0).round() as u64;
        format!(" · {}:{:02} h left", minutes / 60, minutes % 60)
    }
}
