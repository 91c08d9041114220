//! `palr-gym expert imitate`, and the imitators of a model card.

use std::path::Path;

use anyhow::bail;
use palr_gym_trainer::expert::card::Measured;
use palr_gym_trainer::expert::fitness::{Fitness, FitnessOptions, Imitated, Imitator, imitator};
use palr_gym_trainer::{Client, PolicySource};
use serde::Serialize;
use tokio::sync::mpsc::unbounded_channel;

use crate::cli::expert::ExpertImitateArguments;
use crate::interrupt::{Interrupted, stop_on_signals};
use crate::watch::Watch;
use crate::{backend, build, output};

/// What is printed as JSON.
#[derive(Debug, Serialize)]
struct Report<'a> {
    env: &'a str,
    policy: String,
    expert: &'a Measured,
    #[serde(flatten)]
    fitness: &'a Fitness,
}

/// Measures a policy, trains its imitators, measures those, and prints.
pub async fn run(arguments: ExpertImitateArguments) -> anyhow::Result<()> {
    let policy = PolicySource::parse(&arguments.policy);
    if matches!(policy, PolicySource::Random) {
        bail!("random has nothing to imitate; expected `expert`, an ONNX policy or a run's folder");
    }
    let folder = match &arguments.out {
        Some(folder) => folder.clone(),
        None => super::state_home()?.join("palr-gym/imitations").join(&arguments.env),
    };
    let client = backend::connect(&arguments.server).await?;
    let options = FitnessOptions {
        transitions: arguments.transitions,
        steps: arguments.steps,
        episodes: arguments.episodes,
    };
    let (env, episodes) = (&arguments.env, arguments.episodes);
    let imitated = Imitated::measure(&client, env, policy, episodes).await?;
    if !arguments.json {
        eprintln!("imitators in {}", folder.display());
    }
    let fitness =
        fitness(&client, &imitated, &folder, options, (arguments.imitators, arguments.json))
            .await?;
    if arguments.json {
        return output::json(&Report {
            env: &imitated.env,
            policy: imitated.policy.label(),
            expert: &imitated.reached,
            fitness: &fitness,
        });
    }
    println!("{}", table(&imitated.reached, &fitness));
    println!("{}", sentence(&fitness));
    Ok(())
}

/// Trains and measures imitators with the seeds 0, 1, .. in `folder`, one after the other.
pub async fn fitness(
    client: &Client,
    imitated: &Imitated,
    folder: &Path,
    options: FitnessOptions,
    (count, is_quiet): (u32, bool),
) -> anyhow::Result<Fitness> {
    let expert_return = imitated.reached.return_mean;
    if expert_return <= 0.0 {
        bail!(
            "{} returns {expert_return:.1} in {}, and a share of that means nothing; expected a policy \
             that returns more than 0",
            imitated.policy,
            imitated.env
        );
    }
    let is_stopped = stop_on_signals();
    let mut imitators = Vec::new();
    for seed in 0..u64::from(count) {
        let (sender, receiver) = unbounded_channel();
        let label = format!("imitator {} of {count}", seed + 1);
        let watch = Watch::new(&label, options.steps, is_quiet);
        let watching = tokio::spawn(watch.follow(receiver));
        let run = (build::GIT_REVISION, is_stopped.clone(), sender);
        let reached = imitator(client, imitated, folder, (options, seed), run).await;
        // It ends with the run.
        let _ = watching.await;
        let Some(reached) = reached? else {
            let message = format!("stopped at {label}; the same command goes on with it");
            return Err(Interrupted { message }.into());
        };
        imitators.push(reached);
    }
    Ok(Fitness::of(imitated, options, imitators))
}

/// A row for the expert and one for each imitator.
fn table(expert: &Measured, fitness: &Fitness) -> comfy_table::Table {
    let header = ["policy", "episodes", "return", "± SE", "lowest", "score", "length", "share"];
    let row = |name: String, reached: &Measured, share: f64| {
        vec![
            name,
            reached.episodes.to_string(),
            format!("{:.1}", reached.return_mean),
            reached.return_standard_error.map_or_else(|| "–".into(), |se| format!("{se:.1}")),
            format!("{:.1}", reached.return_min),
            format!("{:.1}", reached.score_mean),
            format!("{:.1}", reached.length_mean),
            format!("{:.1} %", 100.0 * share),
        ]
    };
    let imitators = fitness.imitators.iter().map(|imitator: &Imitator| {
        row(
            format!("imitator, seed {}", imitator.seed),
            &imitator.reached,
            imitator.share_of_expert,
        )
    });
    let rows = std::iter::once(row("expert".into(), expert, 1.0)).chain(imitators).collect();
    output::table(&header, rows, 1)
}

/// What the imitators reached together.
pub fn sentence(fitness: &Fitness) -> String {
    format!(
        "plain behaviour cloning ({} sampled transitions, {} steps, {}) reaches {:.1}{} % of the \
         expert's return",
        fitness.transitions,
        fitness.steps,
        match fitness.imitators.len() {
            1 => "one imitator".to_owned(),
            count => format!("{count} imitators"),
        },
        100.0 * fitness.share_of_expert,
        fitness.share_standard_error.map_or_else(String::new, |se| format!(" ± {:.1}", 100.0 * se)),
    )
}
