//! `palr-gym data`

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::ServerArguments;

/// `palr-gym data`
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  palr-gym data info hopper.hdf5
  palr-gym data info d4rl.hdf5 --env hopper --json
  palr-gym data info hopper.hdf5 --plot hopper    histograms of returns and actions
  palr-gym data verify hopper.hdf5        exit code 1 if something is wrong with it
  palr-gym data slice hopper.hdf5 small.hdf5 --transitions 5000
  palr-gym data prepare hopper.hdf5 rows.safetensors --env hopper-w2
  palr-gym data convert hopper.hdf5 hopper-expert-v0    a data set of Minari's, and back:
  palr-gym data convert ~/.minari/datasets/mujoco/hopper/expert-v0 hopper.hdf5")]
pub struct DataArguments {
    #[command(subcommand)]
    pub command: DataCommand,
}

/// What to do with a data set.
#[derive(Debug, Subcommand)]
pub enum DataCommand {
    /// Episodes, returns, scores, saturation, persistence and repetition of actions.
    Info(DataInfoArguments),
    /// Check what training relies on, finding by finding.
    Verify(DataFileArguments),
    /// Copy some of the episodes.
    Slice(DataSliceArguments),
    /// Copy from D4RL's layout to Minari's, or back.
    Convert(DataConvertArguments),
    /// Write the rows that a method would train on: masked, stacked, standardised, with past actions.
    Prepare(DataPrepareArguments),
}

/// `palr-gym data info`
#[derive(Debug, Args)]
pub struct DataInfoArguments {
    #[command(flatten)]
    pub data: DataFileArguments,
    /// Draw histograms of returns, lengths and actions, as PATH.svg and PATH.png.
    #[arg(long, value_name = "PATH")]
    pub plot: Option<PathBuf>,
}

/// `palr-gym data prepare`
#[derive(Debug, Args)]
#[command(after_help = "\
What `palr-gym train` with the same settings trains on, to the bit, as float32 tensors in a safetensors
file that NumPy, JAX and torch read: training.observations [n, w·d], training.actions and
training.past_actions [n, A]; held_out.* likewise; observation_mean and observation_std [w·d]. The rules
stand in docs/preprocessing.md.

Example: palr-gym data prepare hopper.hdf5 rows.safetensors --env hopper-w2 --training-rows 30000")]
pub struct DataPrepareArguments {
    /// HDF5 file in D4RL's layout, or a folder in Minari's; with full observations.
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// What to write; must not be there.
    #[arg(value_name = "OUT")]
    pub out: PathBuf,
    /// Environment as which a policy would see the data, such as hopper-w2.
    #[arg(long, value_name = "ID")]
    pub env: String,
    /// Rows to train on, from the first [default: 30000].
    #[arg(long, value_name = "N")]
    pub training_rows: Option<usize>,
    /// Rows to hold out; 0 for none [default: 2000].
    #[arg(long, value_name = "N")]
    pub held_out_rows: Option<usize>,
    /// Consecutive rows from this one on are held out, as in the paper (900000) [default: spread over the
    /// episodes after the training rows].
    #[arg(long, value_name = "ROW")]
    pub held_out_start: Option<usize>,
    /// Rows that observations are standardised by.
    #[arg(long, value_name = "ROWS", default_value = "training", value_parser = ["training", "all"])]
    pub statistics: String,
    #[command(flatten)]
    pub server: ServerArguments,
    /// Print the result as JSON.
    #[arg(long)]
    pub json: bool,
}

/// `palr-gym data slice`
#[derive(Debug, Args)]
#[command(after_help = "\
Nothing is held in memory but one episode at a time. The layout of OUT follows from its name: HDF5 in
D4RL's if it ends in .hdf5 or .h5, else a folder in Minari's.")]
pub struct DataSliceArguments {
    #[command(flatten)]
    pub convert: DataConvertArguments,
    /// First episode, from 0.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub first_episode: usize,
    /// Episodes [default: all that follow].
    #[arg(long, value_name = "N")]
    pub episodes: Option<usize>,
    /// Most transitions; the last episode is cut, as if the recording had stopped there.
    #[arg(long, value_name = "N")]
    pub transitions: Option<usize>,
}

/// `palr-gym data convert`
#[derive(Debug, Args)]
#[command(after_help = "\
Nothing is held in memory but one episode at a time. The layout of OUT follows from its name: HDF5 in
D4RL's if it ends in .hdf5 or .h5, else a folder in Minari's. D4RL's layout holds observations as
float32; Minari's keeps the type that it is given.")]
pub struct DataConvertArguments {
    /// HDF5 file in D4RL's layout, or a folder in Minari's.
    #[arg(value_name = "IN")]
    pub from: PathBuf,
    /// What to write; must not be there.
    #[arg(value_name = "OUT")]
    pub to: PathBuf,
    /// Name of the data set in Minari's layout, ending in -vN [default: OUT's name].
    #[arg(long, value_name = "NAME")]
    pub id: Option<String>,
    /// Print the result as JSON.
    #[arg(long)]
    pub json: bool,
}

/// A data set.
#[derive(Debug, Args)]
pub struct DataFileArguments {
    /// HDF5 file in D4RL's layout, or a folder in Minari's.
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Task for normalised scores [default: what the file says that it holds].
    #[arg(long, value_name = "ID")]
    pub env: Option<String>,
    #[command(flatten)]
    pub server: ServerArguments,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}
