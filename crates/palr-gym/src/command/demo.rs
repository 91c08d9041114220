//! `palr-gym demo`: the main job on real input, from nothing.

use std::net::{Ipv4Addr, SocketAddr};
use std::time::Instant;

use anyhow::Context;
use palr_gym_core::ActionMode;
use palr_gym_proto::v1::collect_request::Amount;
use palr_gym_server::{Listener, Server, ServerConfig};
use palr_gym_trainer::collect::{CollectOptions, Collected, Existing};
use palr_gym_trainer::evaluate::{EvaluateOptions, Evaluation};
use palr_gym_trainer::plot::{ReturnsGroup, returns_figure};
use palr_gym_trainer::runs::Run;
use palr_gym_trainer::{Client, PolicySource, ServerAddress};
use serde::{Deserialize, Serialize};

use super::{collect, evaluate};
use crate::cli::DemoArguments;
use crate::output;

const CONFIG: &str = "config.json";
const RESULTS: &str = "results.json";
const FIGURE: &str = "returns";

/// What a run is to do; fixed when its folder is made.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Config {
    env: String,
    transitions: u64,
    episodes: u32,
    seed: u64,
    palr_gym_version: String,
}

/// What a run measured.
#[derive(Debug, Serialize, Deserialize)]
struct Results {
    config: Config,
    data: Collected,
    evaluations: Vec<Evaluation>,
}

/// Collects, evaluates, prints a table and draws a figure.
pub async fn run(arguments: DemoArguments) -> anyhow::Result<()> {
    let started = Instant::now();
    let (run, config) = open_run(&arguments)?;
    let say = |text: &str| {
        if !arguments.json {
            println!("{text}");
        }
    };
    let (client, address) = start_server().await?;
    say(&format!("run folder    {}", run.folder().display()));
    say(&format!("server        {address}"));

    let data = collect::with_progress(&client, &collection(&run, &config)).await?;
    say(&format!(
        "data          {} ({} transitions, {} episodes, expert, sampled actions)",
        data.path.display(),
        data.transitions,
        data.episodes
    ));
    let mut evaluations = Vec::new();
    for policy in [PolicySource::Expert, PolicySource::Random] {
        evaluations.push(evaluate_once(&client, &run, &config, policy).await?);
    }
    let results = Results { config, data, evaluations };
    run.write_json(RESULTS, &results)?;
    draw(&client, &run, &results).await?;
    if arguments.json {
        return output::json(&results);
    }
    println!("{}", output::evaluation_table(&results.evaluations));
    println!("results       {}", run.path(RESULTS).display());
    println!("figure        {} and .png", run.path(FIGURE).with_extension("svg").display());
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
    let run = Run::create(&arguments.out)?;
    let config = Config {
        env: arguments.env.clone(),
        transitions: arguments.transitions,
        episodes: arguments.episodes,
        seed: arguments.seed,
        palr_gym_version: palr_gym_server::VERSION.to_owned(),
    };
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
        env_id: config.env.clone(),
        policy: PolicySource::Expert,
        amount: Amount::Transitions(config.transitions),
        seed: config.seed,
        action_mode: ActionMode::Sampled,
        num_envs: None,
        out: run.path(&format!("{}-expert.hdf5", config.env)),
        existing: Existing::Resume,
    }
}

/// Evaluates, or takes the result of this run's earlier evaluation.
async fn evaluate_once(
    client: &Client,
    run: &Run,
    config: &Config,
    policy: PolicySource,
) -> anyhow::Result<Evaluation> {
    let name = format!("evaluation-{policy}.json");
    if let Some(evaluation) = run.read_json(&name)? {
        return Ok(evaluation);
    }
    let label = match policy {
        PolicySource::Expert => "evaluate expert",
        _ => "evaluate random",
    };
    let options = EvaluateOptions {
        env_id: config.env.clone(),
        policy,
        episodes: config.episodes,
        seed: config.seed,
        action_mode: ActionMode::Deterministic,
        num_envs: None,
    };
    let evaluation = evaluate::with_progress(client, &options, label).await?;
    run.write_json(&name, &evaluation)?;
    Ok(evaluation)
}

async fn draw(client: &Client, run: &Run, results: &Results) -> anyhow::Result<()> {
    let spec = client.spec(&results.config.env).await?;
    let references = spec
        .reference_returns
        .map(|returns| [("D4RL score 0", returns.random), ("D4RL score 100", returns.expert)]);
    let groups: Vec<ReturnsGroup> = results
        .evaluations
        .iter()
        .map(|evaluation| ReturnsGroup {
            label: evaluation.policy.clone(),
            returns: evaluation.episodes.iter().map(|episode| episode.episode_return).collect(),
            mean: evaluation.return_mean,
            standard_error: evaluation.return_standard_error,
            score: evaluation.score_mean,
        })
        .collect();
    let title = format!("{}: {} episodes each, mean ± SE", spec.env_id, results.config.episodes);
    let references = references.as_ref().map_or(&[][..], |references| references);
    returns_figure(&run.path(FIGURE), &title, references, &groups)?;
    Ok(())
}
