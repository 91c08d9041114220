//! `palr-gym collect`

use palr_gym_proto::v1::collect_request::Amount;
use palr_gym_trainer::collect::{CollectOptions, Collected, Existing, collect};
use palr_gym_trainer::{Client, PolicySource};

use super::evaluate::action_mode;
use crate::cli::CollectArguments;
use crate::{backend, output, progress};

const DEFAULT_TRANSITIONS: u64 = 30_000;

/// Collects and prints where to.
pub async fn run(arguments: CollectArguments) -> anyhow::Result<()> {
    let client = backend::connect(&arguments.server).await?;
    let existing = match (arguments.resume, arguments.force) {
        (true, _) => Existing::Resume,
        (_, true) => Existing::Replace,
        _ => Existing::Keep,
    };
    let amount = match (arguments.episodes, arguments.transitions) {
        (Some(episodes), _) => Amount::Episodes(episodes),
        (None, transitions) => Amount::Transitions(transitions.unwrap_or(DEFAULT_TRANSITIONS)),
    };
    let policy = arguments.policy;
    let options = CollectOptions {
        env_id: policy.env,
        policy: PolicySource::parse(&policy.policy),
        amount,
        seed: policy.seed,
        action_mode: action_mode(policy.sampled),
        num_envs: policy.num_envs,
        scene_options: policy.scene.options(),
        out: arguments.out,
        existing,
    };
    let collected = with_progress(&client, &options).await?;
    if arguments.json {
        return output::json(&collected);
    }
    let Collected { path, transitions, episodes, resumed_episodes, was_complete } = collected;
    let how = match (was_complete, resumed_episodes) {
        (true, _) => " (was complete already)".to_owned(),
        (false, 0) => String::new(),
        (false, resumed) => format!(" ({resumed} episodes from the interrupted recording)"),
    };
    println!("{}: {transitions} transitions in {episodes} episodes{how}", path.display());
    Ok(())
}

/// Collects with a bar.
pub async fn with_progress(client: &Client, options: &CollectOptions) -> anyhow::Result<Collected> {
    let (total, unit) = match options.amount {
        Amount::Transitions(transitions) => (transitions, "transitions"),
        Amount::Episodes(episodes) => (u64::from(episodes), "episodes"),
    };
    let bar = progress::bar("collect", total, unit);
    let collected = collect(client, options, |progress| {
        bar.set_position(match options.amount {
            Amount::Transitions(_) => progress.transitions,
            Amount::Episodes(_) => u64::from(progress.episodes),
        });
    })
    .await;
    bar.finish_and_clear();
    Ok(collected?)
}
