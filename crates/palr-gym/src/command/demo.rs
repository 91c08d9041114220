//! `palr-gym demo`: the main job on real input, from nothing.

mod story;

use std::net::{Ipv4Addr, SocketAddr};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::Context;
use indicatif::MultiProgress;
use palr_gym_core::{ActionMode, EnvId};
use palr_gym_proto::v1::collect_request::Amount;
use palr_gym_server::{Listener, Server, ServerConfig};
use palr_gym_trainer::collect::{CollectOptions, Existing};
use palr_gym_trainer::evaluate::EvaluateOptions;
use palr_gym_trainer::imitate::manifest::{FILE as MANIFEST, Manifest};
use palr_gym_trainer::imitate::settings::Settings;
use palr_gym_trainer::imitate::{Imitation, Outcome};
use palr_gym_trainer::leakage::{Leakage, LeakageOptions, estimate};
use palr_gym_trainer::runs::Run;
use palr_gym_trainer::{Client, ClientError, PolicySource, ServerAddress};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tokio::sync::mpsc::unbounded_channel;

use self::story::{Player, Results};
use super::{collect, evaluate};
use crate::cli::DemoArguments;
use crate::interrupt::{Interrupted, stop_on_signals};
use crate::watch::Watch;
use crate::{build, output};

const CONFIG: &str = "config.json";
const RESULTS: &str = "results.json";
const FIGURE: &str = "figure";
/// Policies that are trained, in the order of tables.
const METHODS: [&str; 2] = ["bc", "palr"];
const MIN_EPISODES: usize = 20;
/// Reports and evaluations of a run, for its curves.
const REPORTS: u64 = 40;
const EVALUATIONS: u64 = 10;
const EVALUATION_EPISODES: u32 = 10;

/// What a run is to do; fixed when its folder is made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Config {
    env: String,
    /// Of the recording: the environment's task, unmasked.
    task: String,
    transitions: u64,
    training_rows: usize,
    held_out_rows: usize,
    steps: u64,
    alpha: f64,
    episodes: u32,
    seed: u64,
    palr_gym_version: String,
}

/// Collects, trains, evaluates, measures leakage, prints a table and draws a figure.
pub async fn run(arguments: DemoArguments) -> anyhow::Result<()> {
    let started = Instant::now();
    let (run, config) = open_run(&arguments)?;
    let say = |text: &str| {
        if !arguments.json {
            println!("{text}");
        }
    };
    let (client, address) = start_server().await?;
    let is_stopped = stop_on_signals();
    say(&format!("run folder    {}", run.folder().display()));
    say(&format!("server        {address}"));

    let data = collect::with_progress(&client, &collection(&run, &config)).await?;
    say(&format!(
        "data          {} ({} transitions, {} episodes, expert, sampled actions)",
        data.path.display(),
        data.transitions,
        data.episodes
    ));
    say(&format!(
        "training      {} side by side, {} steps each on {} rows",
        METHODS.join(" and "),
        config.steps,
        config.training_rows
    ));
    train(&client, &run, &config, &data.path, &is_stopped, arguments.json).await?;

    let mut players = Vec::new();
    for name in ["expert"].into_iter().chain(METHODS).chain(["random"]) {
        if is_stopped.load(Ordering::Relaxed) {
            return Err(interrupted(&run).into());
        }
        players.push(measure(&client, &run, &config, &data.path, name).await?);
    }
    let results = Results { data, players };
    run.write_json(RESULTS, &json!({"config": config, "results": results}))?;
    let title = format!("{}: {} steps on {} rows", config.env, config.steps, config.training_rows);
    results.draw(&run.path(FIGURE), &title)?;
    if arguments.json {
        return output::json(&results);
    }
    println!("{}", results.table());
    println!("{}", results.reading());
    println!("results       {}", run.path(RESULTS).display());
    println!("figure        {} and .png", run.path(FIGURE).with_extension("svg").display());
    println!(
        "full recipe   palr-gym train --env {} --data {} --algorithm palr --steps 500000",
        config.env,
        results.data.path.display()
    );
    println!("took          {:.0} s", started.elapsed().as_secs_f64());
    Ok(())
}

fn open_run(arguments: &DemoArguments) -> anyhow::Result<(Run, Config)> {
    if arguments.resume {
        let run = Run::open_latest(&arguments.out)?;
        let config = run.read_json(CONFIG)?.with_context(|| {
            format!("{} was interrupted before it began; start a new run", run.folder().display())
        })?;
        return Ok((run, config));
    }
    let config = Config {
        env: arguments.env.clone(),
        // An id that cannot be read is refused by the server, with the nearest one.
        task: arguments.env.parse::<EnvId>().map_or(arguments.env.clone(), |env_id| env_id.task),
        transitions: arguments.transitions,
        training_rows: arguments.training_rows,
        held_out_rows: arguments.held_out_rows,
        steps: arguments.steps,
        alpha: arguments.alpha,
        episodes: arguments.episodes,
        seed: arguments.seed,
        palr_gym_version: palr_gym_server::VERSION.to_owned(),
    };
    // What is wrong with the settings is found before a folder is made.
    for method in METHODS {
        settings(&config, method, Path::new("to be collected"))?;
    }
    let run = Run::create(&arguments.out)?;
    run.write_json(CONFIG, &config)?;
    Ok((run, config))
}

/// A server on a port of its own, which any other client could use meanwhile.
async fn start_server() -> anyhow::Result<(Client, ServerAddress)> {
    let listener = Listener::tcp(SocketAddr::from((Ipv4Addr::LOCALHOST, 0))).await?;
    let address = listener.local_address().context("the server has no address")?;
    let server = Server::new(ServerConfig::default())?;
    tokio::spawn(server.serve(vec![listener], std::future::pending()));
    let address = ServerAddress::Tcp(address.to_string());
    Ok((Client::connect(&address).await?, address))
}

fn collection(run: &Run, config: &Config) -> CollectOptions {
    CollectOptions {
        env_id: config.task.clone(),
        policy: PolicySource::Expert,
        amount: Amount::Transitions(config.transitions),
        seed: config.seed,
        action_mode: ActionMode::Sampled,
        num_envs: None,
        scene_options: None,
        out: run.path(&format!("{}-expert.hdf5", config.task)),
        existing: Existing::Resume,
    }
}

fn settings(config: &Config, method: &str, data: &Path) -> Result<Settings, ClientError> {
    let layer = json!({
        "env": config.env,
        "data": data,
        "training_rows": config.training_rows,
        "held_out": {"rows": config.held_out_rows, "min_episodes": MIN_EPISODES},
        "evaluation": {
            "every": (config.steps / EVALUATIONS).max(1),
            "episodes": EVALUATION_EPISODES,
            // Other episodes than those of the table.
            "seed": config.seed.wrapping_add(1_000_000),
        },
        "algorithm": method,
        "steps": config.steps,
        "seed": config.seed,
        "log_every": (config.steps / REPORTS).max(1),
        "checkpoint_every": 1000,
        "metric_rows": config.held_out_rows.max(2),
        "palr": {"alpha": config.alpha, "weights": "pool"},
    });
    Settings::from_layers(&[layer])
}

/// Each method in a thread of its own, each in a run's folder.
async fn train(
    client: &Client,
    run: &Run,
    config: &Config,
    data: &Path,
    is_stopped: &Arc<AtomicBool>,
    is_quiet: bool,
) -> anyhow::Result<()> {
    let bars = MultiProgress::new();
    let mut runs = Vec::new();
    for method in METHODS {
        let folder = run.path(method);
        let imitation = if folder.join(MANIFEST).exists() {
            let same = |stored: Value| Settings::from_layers(&[stored]);
            Imitation::resume(client, Run::open(&folder)?, same).await?
        } else {
            let settings = settings(config, method, data)?;
            Imitation::start_in(client, &folder, settings, build::GIT_REVISION).await?
        };
        let (sender, receiver) = unbounded_channel();
        let watch = Watch::new(method, config.steps, is_quiet).among(&bars);
        let watching = tokio::spawn(watch.follow(receiver));
        let (client, is_stopped) = (client.clone(), Arc::clone(is_stopped));
        runs.push(tokio::spawn(async move {
            let outcome = imitation.run(&client, is_stopped, sender).await;
            // It ends with the run.
            let _ = watching.await;
            outcome
        }));
    }
    // All of them first: each has a checkpoint to write.
    let mut outcomes: Vec<Result<Outcome, ClientError>> = Vec::new();
    for one in runs {
        outcomes.push(one.await.context("a run panicked")?);
    }
    for outcome in outcomes {
        if !outcome?.is_complete {
            return Err(interrupted(run).into());
        }
    }
    Ok(())
}

fn interrupted(run: &Run) -> Interrupted {
    let folder = run.folder().display();
    Interrupted { message: format!("stopped; `palr-gym demo --resume` goes on in {folder}") }
}

/// Plays and measures, or takes the results of this run's earlier measurements.
async fn measure(
    client: &Client,
    run: &Run,
    config: &Config,
    data: &Path,
    name: &str,
) -> anyhow::Result<Player> {
    let file = format!("player-{name}.json");
    if let Some(player) = run.read_json(&file)? {
        return Ok(player);
    }
    let folder = run.path(name);
    let is_trained = METHODS.contains(&name);
    let policy =
        if is_trained { PolicySource::File(folder.clone()) } else { PolicySource::parse(name) };
    // The expert knows the full observation only.
    let env_id = if name == "expert" { &config.task } else { &config.env };
    let options = EvaluateOptions {
        env_id: config.env.clone(),
        policy: policy.clone(),
        episodes: config.episodes,
        seed: config.seed,
        action_mode: ActionMode::Deterministic,
        num_envs: None,
        scene_options: None,
    };
    let evaluation = evaluate::with_progress(client, &options, &format!("evaluate {name}")).await?;
    let held_out = palr_gym_data::HeldOut::spread(config.held_out_rows, MIN_EPISODES);
    let options = LeakageOptions {
        env_id: env_id.clone(),
        policy,
        data: data.to_path_buf(),
        selection: held_out.after(config.training_rows),
        action_mode: if name == "random" { ActionMode::Deterministic } else { ActionMode::Sampled },
        ridge: None,
        bandwidth_sq: None,
        seed: config.seed,
    };
    let leakage: Leakage = estimate(client, &options).await?;
    let player = if is_trained {
        let manifest = Manifest::read(&folder)?;
        Player::trained(name, evaluation, leakage, &folder, manifest)?
    } else {
        Player::given(name, evaluation, leakage)
    };
    run.write_json(&file, &player)?;
    Ok(player)
}
