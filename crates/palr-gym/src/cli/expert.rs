//! `palr-gym expert`

use std::path::PathBuf;

use clap::{Args, Subcommand};
use palr_gym_trainer::expert::fitness::FitnessOptions;
use serde_json::{Value, json};

use super::ServerArguments;

/// `palr-gym expert`
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  palr-gym expert train --env hopper
  palr-gym expert card ~/.local/state/palr-gym/experts/hopper
  palr-gym expert imitate --env hopper")]
pub struct ExpertArguments {
    #[command(subcommand)]
    pub command: ExpertCommand,
}

/// What to do about experts.
#[derive(Debug, Subcommand)]
pub enum ExpertCommand {
    /// Train an expert from nothing, by soft actor-critic.
    Train(ExpertTrainArguments),
    /// Measure the best policy of a run and write its model card.
    Card(ExpertCardArguments),
    /// Measure how well plain behaviour cloning imitates an expert.
    Imitate(ExpertImitateArguments),
    /// Draw how the returns of experts grew.
    Plot(ExpertPlotArguments),
}

/// `palr-gym expert train`
#[derive(Debug, Args)]
#[command(after_help = "\
Truncated quantile critics (or plain SAC) with an automatic temperature, on what the environment shows:
name the bare task for the full observation. Steps are transitions of all environments together; there
are fewer updates than steps, because simulation is cheap. The best policy that was evaluated is kept.

The folder holds expert.json, metrics.jsonl, evaluations.jsonl, tensorboard/, policy.onnx,
policy.safetensors, card.json once finished, and a checkpoint of less than 5 MB. Ctrl-C or SIGTERM
writes one, with replay.safetensors beside it (hundreds of megabytes), and exits with 130; so does a kill
cost only what came after the last one. Without its replay, after a kill, a run first collects transitions
with its policy, and may learn badly from such narrow ones for a while.

A gait that falls at an imitator's smallest error is of little use to a benchmark; `expert imitate` measures
that. What helped ant most is a target_entropy of 0: what noise leads astray shows imitators the way back.
Further settings against it, off unless set: perturbation and perturbation_duration (pushes on the
actuators), reward_cap (the most that a step's reward counts for), healthy_z_range (heights beyond which
nothing counts; needs the full observation), episode_steps (shorter episodes: more starts). They may change
on the way; scenes/experts/README.md says what they did for ant.

Examples:
  palr-gym expert train --env hopper
  palr-gym expert train --env hopper --resume
  palr-gym expert train --env ant --from scenes/experts/checkpoints/ant.safetensors
  palr-gym expert train --env walker2d --critic sac --steps 1000000 --set updates_per_step=1
  palr-gym expert train --env ant --set reward_cap=4.5 --set 'healthy_z_range=[0.4,0.95]'
  palr-gym expert card ~/.local/state/palr-gym/experts/hopper
  palr-gym evaluate --env hopper --policy ~/.local/state/palr-gym/experts/hopper/policy.onnx")]
pub struct ExpertTrainArguments {
    /// Environment, such as hopper.
    #[arg(long, value_name = "ID")]
    pub env: String,
    /// How the critics estimate returns: tqc or sac [default: tqc; on ant: sac].
    #[arg(long, value_name = "KIND")]
    pub critic: Option<String>,
    /// Transitions to collect in all [default: 8000000].
    #[arg(long, value_name = "N")]
    pub steps: Option<u64>,
    /// Seed of everything [default: 0].
    #[arg(long, value_name = "S")]
    pub seed: Option<u64>,
    /// Environments side by side [default: 16].
    #[arg(long, value_name = "N")]
    pub num_envs: Option<usize>,
    /// Updates for each transition [default: 0.25].
    #[arg(long, value_name = "RATIO")]
    pub updates_per_step: Option<f64>,
    /// Transitions between two evaluations [default: 50000].
    #[arg(long, value_name = "N")]
    pub evaluate_every: Option<u64>,
    /// Episodes of an evaluation [default: 10].
    #[arg(long, value_name = "N")]
    pub episodes: Option<u32>,
    /// Episodes of a finished run's card, for the mean action and for sampled ones; 0 for no card.
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub card_episodes: u32,
    /// Any setting by its name, such as batch=512; over everything else.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Print the settings as TOML and stop.
    #[arg(long)]
    pub print_config: bool,
    /// The run's folder [default: $XDG_STATE_HOME/palr-gym/experts/ID].
    #[arg(long, value_name = "FOLDER")]
    pub out: Option<PathBuf>,
    /// Go on with the run in the folder, with its own settings.
    #[arg(long, conflicts_with = "from")]
    pub resume: bool,
    /// Begin a new folder from this checkpoint, with its settings.
    #[arg(long, value_name = "CHECKPOINT")]
    pub from: Option<PathBuf>,
    #[command(flatten)]
    pub server: ServerArguments,
    /// Print the result as JSON.
    #[arg(long)]
    pub json: bool,
}

impl ExpertTrainArguments {
    /// What the flags set, by setting.
    pub fn flags(&self) -> Vec<(&'static str, Value)> {
        let flags = [
            ("critic", self.critic.as_ref().map(|value| json!(value))),
            ("steps", self.steps.map(|value| json!(value))),
            ("seed", self.seed.map(|value| json!(value))),
            ("num_envs", self.num_envs.map(|value| json!(value))),
            ("updates_per_step", self.updates_per_step.map(|value| json!(value))),
            ("evaluate_every", self.evaluate_every.map(|value| json!(value))),
            ("episodes", self.episodes.map(|value| json!(value))),
        ];
        flags.into_iter().filter_map(|(name, value)| Some((name, value?))).collect()
    }
}

/// `palr-gym expert card`
#[derive(Debug, Args)]
#[command(after_help = "\
Writes card.json into the folder: command, settings, curve, wall time, checksums, and the returns of
the mean and of the sampled action over episodes that chose nothing.

With --imitate, also whether the expert is fit for a benchmark: plain behaviour cloning of 30 000 of its
sampled transitions, on full observations, should reach 90 % of its return. The imitators are trained and
measured in the folder imitation/; Ctrl-C stops that and the same command goes on.

Examples:
  palr-gym expert card ~/.local/state/palr-gym/experts/hopper --episodes 100
  palr-gym expert card ~/.local/state/palr-gym/experts/hopper --imitate --imitation-steps 50000")]
pub struct ExpertCardArguments {
    /// The run's folder.
    #[arg(value_name = "FOLDER")]
    pub folder: PathBuf,
    /// Episodes, for the mean action and for sampled ones (and for each imitator).
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub episodes: u32,
    /// Train imitators too and state what they reach.
    #[arg(long)]
    pub imitate: bool,
    /// How many, with the seeds 0, 1, .. (of the recording and of the training).
    #[arg(long, value_name = "N", default_value_t = 3, requires = "imitate",
          value_parser = clap::value_parser!(u32).range(1..))]
    pub imitators: u32,
    /// Steps of behaviour cloning.
    #[arg(long, value_name = "N", default_value_t = FitnessOptions::STEPS, requires = "imitate")]
    pub imitation_steps: u64,
    #[command(flatten)]
    pub server: ServerArguments,
    /// Print the card as JSON.
    #[arg(long)]
    pub json: bool,
}

/// `palr-gym expert imitate`
#[derive(Debug, Args)]
#[command(after_help = "\
An expert is fit for a benchmark if plain behaviour cloning of 30 000 of its sampled transitions, on full
observations, reaches 90 % of its return: else its gait is too brittle to tell methods apart. Imitators
differ, so there are several; each has a recording and a training of its own. Name the bare task, such as
ant: what a stack shows is not the full observation.

Recordings and runs stay in the folder: Ctrl-C stops, and the same command goes on. Each run there is a
policy for `palr-gym evaluate` and `palr-gym render`.

Examples:
  palr-gym expert imitate --env hopper
  palr-gym expert imitate --env ant --imitators 5 --steps 100000
  palr-gym expert imitate --env hopper --policy mine.onnx --json")]
pub struct ExpertImitateArguments {
    /// Environment, such as hopper.
    #[arg(long, value_name = "ID")]
    pub env: String,
    /// Who is imitated: expert, an ONNX file, or the folder of a finished run.
    #[arg(long, value_name = "POLICY", default_value = "expert")]
    pub policy: String,
    /// How many imitators, with the seeds 0, 1, .. (of the recording and of the training).
    #[arg(long, value_name = "N", default_value_t = 3,
          value_parser = clap::value_parser!(u32).range(1..))]
    pub imitators: u32,
    /// Sampled transitions that each learns from.
    #[arg(long, value_name = "N", default_value_t = FitnessOptions::TRANSITIONS)]
    pub transitions: u64,
    /// Steps of behaviour cloning.
    #[arg(long, value_name = "N", default_value_t = FitnessOptions::STEPS)]
    pub steps: u64,
    /// Episodes that the expert and each imitator are measured on.
    #[arg(long, value_name = "N", default_value_t = 100)]
    pub episodes: u32,
    /// Where they live [default: $XDG_STATE_HOME/palr-gym/imitations/ID].
    #[arg(long, value_name = "FOLDER")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    pub server: ServerArguments,
    /// Print the result as JSON.
    #[arg(long)]
    pub json: bool,
}

/// `palr-gym expert plot`
#[derive(Debug, Args)]
#[command(after_help = "\
Example: palr-gym expert plot scenes/experts/hopper.json scenes/experts/walker2d.json --out experts")]
pub struct ExpertPlotArguments {
    /// Model cards, or folders that hold one.
    #[arg(value_name = "CARD", required = true)]
    pub cards: Vec<PathBuf>,
    /// Writes PATH.svg and PATH.png.
    #[arg(long, value_name = "PATH")]
    pub out: PathBuf,
}
