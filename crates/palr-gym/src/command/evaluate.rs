//! `palr-gym evaluate`

use palr_gym_core::ActionMode;
use palr_gym_trainer::evaluate::{EvaluateOptions, Evaluation, evaluate};
use palr_gym_trainer::{Client, PolicySource};

use crate::cli::EvaluateArguments;
use crate::{backend, output, progress};

/// Evaluates and prints.
pub async fn run(arguments: EvaluateArguments) -> anyhow::Result<()> {
    let client = backend::connect(&arguments.server).await?;
    let policy = arguments.policy;
    let options = EvaluateOptions {
        env_id: policy.env,
        policy: PolicySource::parse(&policy.policy),
        episodes: arguments.episodes,
        seed: policy.seed,
        action_mode: action_mode(policy.sampled),
        num_envs: policy.num_envs,
        scene_options: policy.scene.options(),
    };
    let evaluation = with_progress(&client, &options, "evaluate").await?;
    if arguments.json {
        output::json(&evaluation)
    } else {
        println!("{}", output::evaluation_table(&[evaluation]));
        Ok(())
    }
}

/// What `--sampled` means.
pub fn action_mode(sampled: bool) -> ActionMode {
    if sampled { ActionMode::Sampled } else { ActionMode::Deterministic }
}

/// Evaluates with a bar that shows the last episode.
pub async fn with_progress(
    client: &Client,
    options: &EvaluateOptions,
    label: &str,
) -> anyhow::Result<Evaluation> {
    let bar = progress::bar(label, u64::from(options.episodes), "episodes");
    let evaluation = evaluate(client, options, |episode| {
        bar.set_message(format!(
            "· episode {}: return {:.1}, {} steps",
            episode.index, episode.episode_return, episode.length
        ));
        bar.inc(1);
    })
    .await;
    bar.finish_and_clear();
    Ok(evaluation?)
}
