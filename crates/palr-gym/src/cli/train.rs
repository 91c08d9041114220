//! `palr-gym train`

use std::path::PathBuf;

use clap::Args;
use serde_json::{Value, json};

use palr_gym_trainer::imitate::settings::nest;

use super::ServerArguments;

/// `palr-gym train`
#[derive(Debug, Args)]
#[command(after_help = "\
The defaults are the paper's recipe: 500 000 steps of Adam on batches of 1024 from the first 30 000
rows. Settings come in layers, the later over the earlier: the defaults of the algorithm, each --config
file, the flags, each --set. --print-config shows what they come to, as a file for --config. Without
--data, 55 000 transitions of the task's expert are recorded first, once, in OUT/../data.

A run has a folder of its own, OUT/001 and so on: run.json says everything about it, metrics.jsonl,
evaluations.jsonl and tensorboard/ hold its curves, policy.onnx is what it leaves. The folder is itself
a policy for `palr-gym evaluate` and `palr-gym leakage`. Ctrl-C or SIGTERM keeps a checkpoint (exit code
130); --resume goes on, to the same bits as if nothing had happened.

Examples:
  palr-gym train --env hopper-w2 --algorithm palr --alpha 10
  palr-gym train --env hopper-w2 --algorithm bc --data hopper.hdf5 --steps 20000
  palr-gym train --config mine.toml --set palr.weights=pool --set evaluation.every=0
  palr-gym train --resume                        the newest run in OUT
  palr-gym train --resume runs/train/003 --steps 1000000
  palr-gym evaluate --env hopper-w2 --policy runs/train/001")]
pub struct TrainArguments {
    /// Environment as which the policy sees the data, such as hopper-w2.
    #[arg(long, value_name = "ID")]
    pub env: Option<String>,
    /// D4RL HDF5 file with full observations [default: recorded from the expert].
    #[arg(long, value_name = "FILE")]
    pub data: Option<PathBuf>,
    /// Which method: bc, kf, primenet, rap, fca, mine, palr, palr_act or vib [default: palr].
    #[arg(long, value_name = "NAME")]
    pub algorithm: Option<String>,
    /// α, the method's own weight: of HSCIC in palr and palr_act, of the adversary in fca, of the
    /// estimate in mine; the temperature of kf, β of vib [default: the paper's for the task].
    #[arg(long, value_name = "α", allow_negative_numbers = true)]
    pub alpha: Option<f64>,
    /// Where PALR's weight matrix comes from: exact, the step's own batch; or pool, a fixed pool of
    /// batches, many times faster [default: exact].
    #[arg(long, value_name = "MODE")]
    pub weights: Option<String>,
    /// Steps of Adam [default: 500000].
    #[arg(long, value_name = "N")]
    pub steps: Option<u64>,
    /// Rows of a step [default: 1024].
    #[arg(long, value_name = "N")]
    pub batch: Option<usize>,
    /// Seed of the initial parameters and the batches [default: 0].
    #[arg(long, value_name = "S")]
    pub seed: Option<u64>,
    /// Rows at the beginning of the file to train on [default: 30000].
    #[arg(long, value_name = "N")]
    pub training_rows: Option<usize>,
    /// Rows after them to hold out and report on, spread over at least 20 episodes; 0 for none
    /// [default: 2000].
    #[arg(long, value_name = "N")]
    pub held_out_rows: Option<usize>,
    /// Steps between two reports [default: 1000].
    #[arg(long, value_name = "N")]
    pub log_every: Option<u64>,
    /// Steps between two evaluations beside training; 0 for none [default: 10000].
    #[arg(long, value_name = "N")]
    pub evaluate_every: Option<u64>,
    /// Episodes of an evaluation [default: 20].
    #[arg(long, value_name = "N")]
    pub episodes: Option<u32>,
    /// TOML file with settings; of several, the later wins.
    #[arg(long, value_name = "FILE")]
    pub config: Vec<PathBuf>,
    /// Any setting by its name, such as palr.ridge=1e-4; over everything else.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Print the settings as TOML and stop.
    #[arg(long)]
    pub print_config: bool,
    /// Folder of runs.
    #[arg(long, value_name = "OUT", default_value = "runs/train")]
    pub out: PathBuf,
    /// Go on with the run in FOLDER, or with the newest in OUT, with its own settings.
    #[arg(long, value_name = "FOLDER", num_args = 0..=1)]
    pub resume: Option<Option<PathBuf>>,
    #[command(flatten)]
    pub server: ServerArguments,
    /// Print the result as JSON.
    #[arg(long)]
    pub json: bool,
}

impl TrainArguments {
    /// What the flags set, a layer each; but for --alpha, which the method has to name.
    pub fn flag_layers(&self) -> Vec<Value> {
        let flags = [
            ("env", self.env.as_ref().map(|value| json!(value))),
            ("data", self.data.as_ref().map(|value| json!(value))),
            ("algorithm", self.algorithm.as_ref().map(|value| json!(value))),
            ("palr.weights", self.weights.as_ref().map(|value| json!(value))),
            ("steps", self.steps.map(|value| json!(value))),
            ("batch", self.batch.map(|value| json!(value))),
            ("seed", self.seed.map(|value| json!(value))),
            ("training_rows", self.training_rows.map(|value| json!(value))),
            ("held_out.rows", self.held_out_rows.map(|value| json!(value))),
            ("log_every", self.log_every.map(|value| json!(value))),
            ("evaluation.every", self.evaluate_every.map(|value| json!(value))),
            ("evaluation.episodes", self.episodes.map(|value| json!(value))),
        ];
        flags.into_iter().filter_map(|(key, value)| Some(nest(key, value?))).collect()
    }
}
