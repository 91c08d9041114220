//! `palr-gym train`

use std::path::PathBuf;
use std::str::FromStr;

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

Several values of --seeds, --frame-stack or --alpha make a run of each combination. They train in one
process over one stream of batches (batch_seed: the first seed), so that PALR's M, most of what its step
costs, is computed once for all of them. Each has a folder of its own and, with its batch_seed, the same
bits alone. Runs that share their batches are not independent replicates.

--alpha auto trains with 0.01, 0.1, ... 10000 so and names the value whose policy gives held-out actions
the highest likelihood where they change: where copying the past action is wrong. No environment is
asked. See docs/alpha.md.

Examples:
  palr-gym train --env hopper-w2 --algorithm palr --alpha 10
  palr-gym train --env hopper-w2 --algorithm bc --data hopper.hdf5 --steps 20000
  palr-gym train --config mine.toml --set palr.weights=pool --set evaluation.every=0
  palr-gym train --env hopper-w2 --seeds 0..4 --frame-stack 2,4 --alpha 0.1,1,10
  palr-gym train --env hopper-w2 --alpha auto
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
    /// Which method: bc, kf, primenet, rap, fca, mine, palr, palr_act, vib, dt or dt_palr [default: palr].
    #[arg(long, value_name = "NAME")]
    pub algorithm: Option<String>,
    /// α, the method's own weight: of HSCIC in palr, palr_act and dt_palr, of the adversary in fca, of the
    /// estimate in mine; the temperature of kf, β of vib [default: the paper's for the task]. Several
    /// with commas; auto, or auto:0.1,1,10 among those, chooses by held-out data.
    #[arg(long, value_name = "α", allow_negative_numbers = true)]
    pub alpha: Option<Alphas>,
    /// Seeds, a run each: 0..4 with both ends, or 0,3,7.
    #[arg(long, value_name = "SEEDS", conflicts_with = "seed")]
    pub seeds: Option<Seeds>,
    /// Observations in a stack, a run each, in the place of the environment's: 2,4.
    #[arg(long, value_name = "N", value_delimiter = ',')]
    pub frame_stack: Vec<usize>,
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
    /// Go on with the runs in the FOLDERs, several together, or with the newest in OUT; with their
    /// own settings.
    #[arg(long, value_name = "FOLDER", num_args = 0.., conflicts_with_all = ["seeds", "frame_stack"])]
    pub resume: Option<Vec<PathBuf>>,
    #[command(flatten)]
    pub server: ServerArguments,
    /// Print the result as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Values of α.
#[derive(Debug, Clone, PartialEq)]
pub struct Alphas {
    /// A run each.
    pub values: Vec<f64>,
    /// Which is best is to be said.
    pub is_auto: bool,
}

impl Alphas {
    /// Powers of ten from the smallest of the paper's to far beyond its largest.
    const AUTO: [f64; 7] = [0.01, 0.1, 1.0, 10.0, 100.0, 1000.0, 10_000.0];
}

impl FromStr for Alphas {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        if text == "auto" {
            return Ok(Self { values: Self::AUTO.to_vec(), is_auto: true });
        }
        let (list, is_auto) = match text.strip_prefix("auto:") {
            Some(list) => (list, true),
            None => (text, false),
        };
        let values = list.split(',').map(|value| value.trim().parse::<f64>());
        let values: Result<Vec<f64>, _> = values.collect();
        let wrong = "expected a number, several with commas, auto or auto:0.1,1,10";
        Ok(Self { values: distinct(values.map_err(|_| wrong.to_owned())?)?, is_auto })
    }
}

/// Seeds of runs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Seeds(pub Vec<u64>);

impl FromStr for Seeds {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let number = |text: &str| {
            let wrong = "expected the first and the last, 0..4, or a list, 0,3,7";
            text.trim().parse::<u64>().map_err(|_| wrong.to_owned())
        };
        let Some((first, last)) = text.split_once("..") else {
            let seeds: Result<_, _> = text.split(',').map(number).collect();
            return distinct(seeds?).map(Self);
        };
        let (first, last) = (number(first)?, number(last)?);
        match last.checked_sub(first) {
            Some(more @ 0..1000) => Ok(Self((0..=more).map(|i| first + i).collect())),
            Some(_) => Err("expected at most 1000 seeds".to_owned()),
            None => Err(format!("{first} comes after {last}")),
        }
    }
}

/// Refuses a value that comes twice: two runs would be the same.
fn distinct<T: PartialEq + std::fmt::Display>(values: Vec<T>) -> Result<Vec<T>, String> {
    let twice = values.iter().enumerate().find(|(i, value)| values[..*i].contains(value));
    match twice {
        Some((_, value)) => Err(format!("{value} comes twice")),
        None => Ok(values),
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_of_seeds_and_alphas_are_read() {
        let seeds = |text: &str| text.parse::<Seeds>().map(|seeds| seeds.0);
        assert_eq!(seeds("0..4"), Ok(vec![0, 1, 2, 3, 4]));
        assert_eq!(seeds("7"), Ok(vec![7]));
        assert_eq!(seeds("3, 1"), Ok(vec![3, 1]));
        assert!(seeds("4..0").unwrap_err().contains("4 comes after 0"));
        assert!(seeds("1,1").unwrap_err().contains("1 comes twice"));
        assert!(seeds("0..4000").unwrap_err().contains("at most 1000"));
        assert!(seeds("a").unwrap_err().contains("expected the first and the last"));
        let alphas = |text: &str| text.parse::<Alphas>();
        assert_eq!(alphas("0.1,10"), Ok(Alphas { values: vec![0.1, 10.0], is_auto: false }));
        assert_eq!(alphas("auto:1,0"), Ok(Alphas { values: vec![1.0, 0.0], is_auto: true }));
        assert_eq!(alphas("auto").unwrap().values.len(), 7);
        assert!(alphas("best").unwrap_err().contains("expected a number"));
    }
}
