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
  palr-gym data verify hopper.hdf5        exit code 1 if something is wrong with it")]
pub struct DataArguments {
    #[command(subcommand)]
    pub command: DataCommand,
}

/// What to do with a data set.
#[derive(Debug, Subcommand)]
pub enum DataCommand {
    /// Episodes, returns, scores, saturation, persistence and repetition of actions.
    Info(DataFileArguments),
    /// Check what training relies on, finding by finding.
    Verify(DataFileArguments),
}

/// A data set.
#[derive(Debug, Args)]
pub struct DataFileArguments {
    /// HDF5 file in D4RL's layout.
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
