//! `palr-gym runs` and `palr-gym plot`

use std::path::PathBuf;

use clap::Args;

/// `palr-gym runs`
#[derive(Debug, Args)]
#[command(after_help = "\
A row for each run in or below the folders: how far it is, its newest held-out likelihood, leakage and
score, and every setting in which the runs differ.

Examples:
  palr-gym runs                          all in runs/
  palr-gym runs runs/train/001 runs/train/004
  palr-gym runs --json | jq '.[].manifest.settings.seed'")]
pub struct RunsArguments {
    /// Folders of runs, or runs.
    #[arg(value_name = "FOLDER", default_value = "runs")]
    pub folders: Vec<PathBuf>,
    /// Print JSON, every recorded number included.
    #[arg(long)]
    pub json: bool,
}

/// `palr-gym plot`
#[derive(Debug, Args)]
#[command(after_help = "\
Draws score, held-out likelihood and leakage of the representation over the steps. Runs that differ in
their seed only become one curve: their mean, in a band of ± one standard error.

Examples:
  palr-gym plot runs/train                       curves.svg and curves.png
  palr-gym plot runs/train/001 runs/train/002 --out bc-against-palr")]
pub struct PlotArguments {
    /// Folders of runs, or runs.
    #[arg(value_name = "FOLDER", required = true)]
    pub folders: Vec<PathBuf>,
    /// Where to, without an extension.
    #[arg(long, value_name = "PATH", default_value = "curves")]
    pub out: PathBuf,
    /// Above the figure.
    #[arg(long, value_name = "TEXT")]
    pub title: Option<String>,
}
