//! The command line, as people read it in `--help`.

pub mod bench;
pub mod data;
pub mod demo;
pub mod expert;
pub mod render;
pub mod runs;
pub mod scene;
pub mod train;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::LazyLock;

use clap::{Args, Parser, Subcommand, ValueEnum};
use palr_gym_trainer::ServerAddress;

pub use data::{DataArguments, DataCommand};
pub use demo::DemoArguments;
pub use runs::{PlotArguments, RunsArguments};
pub use train::TrainArguments;

/// Version of this program and of MuJoCo.
static VERSION: LazyLock<String> = LazyLock::new(|| {
    let mujoco = palr_gym_sim::mujoco_log::mujoco_version();
    format!("{} (MuJoCo {mujoco})", palr_gym_server::VERSION)
});

/// Hosts partially observable MuJoCo environments over gRPC, and evaluates and records policies in
/// them.
#[derive(Debug, Parser)]
#[command(name = "palr-gym", version = VERSION.as_str(), arg_required_else_help = true)]
#[command(after_help = "\
Start with:
  palr-gym demo                                  the whole story in a few minutes
  palr-gym serve                                 then step it from Python or any language
  palr-gym evaluate --env hopper --policy expert
  palr-gym envs                                  what there is

An environment is TASK[-full|-paper|-strict|-pixels][-gym5][-wN]: `hopper` shows the full observation, `hopper-w2`
the PALR paper's partial one with the last two observations stacked.")]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
    /// How log lines look (they go to stderr; PALR_GYM_LOG=debug shows more).
    #[arg(long, global = true, value_enum, default_value_t = LogFormat::Text)]
    pub log_format: LogFormat,
}

/// Format of log lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Serve environments until interrupted.
    Serve(ServeArguments),
    /// List tasks, or describe one environment.
    Envs(EnvsArguments),
    /// Record demonstrations as a D4RL HDF5 file.
    Collect(CollectArguments),
    /// Play episodes with a policy on the server and report returns and scores.
    Evaluate(EvaluateArguments),
    /// Draw an episode or a session, as PNG or GIF.
    Render(render::RenderArguments),
    /// Train a policy on recorded demonstrations, with any of eleven methods.
    Train(Box<TrainArguments>),
    /// Train experts from nothing, and describe them.
    Expert(expert::ExpertArguments),
    /// Describe and check data sets.
    Data(DataArguments),
    /// List training runs and compare them.
    Runs(RunsArguments),
    /// Draw the curves of training runs.
    Plot(PlotArguments),
    /// Estimate how much a policy's actions repeat the expert's past ones.
    Leakage(LeakageArguments),
    /// Measure how fast a server is, in steps per second or microseconds a step.
    Bench(bench::BenchArguments),
    /// Record, train, evaluate, measure and draw, from nothing, in a folder of its own.
    Demo(DemoArguments),
    /// Print a completion script for a shell.
    Completions(CompletionsArguments),
}

/// Where the server is.
#[derive(Debug, Args)]
pub struct ServerArguments {
    /// A running server: HOST:PORT or unix:PATH. Without it, this program serves itself.
    #[arg(long, env = "PALR_GYM_SERVER", value_name = "ADDR")]
    pub server: Option<ServerAddress>,
    /// Give up when the server says nothing for this many seconds.
    #[arg(long, value_name = "SECONDS", default_value_t = 120, value_parser = clap::value_parser!(u64).range(1..))]
    pub deadline: u64,
}

/// `palr-gym serve`
#[derive(Debug, Args)]
#[command(after_help = "\
Without --listen and --unix it listens on 127.0.0.1:7257. Both may be given. SIGINT and SIGTERM
drain it: health checks turn to NOT_SERVING, running steps are answered, then it exits with 0.

Examples:
  palr-gym serve
  palr-gym serve --listen 0.0.0.0:7257 --threads 8
  palr-gym serve --unix /tmp/palr-gym.sock
  palr-gym serve --listen 127.0.0.1:0 --json     any free port, told in JSON on stdout")]
pub struct ServeArguments {
    /// TCP address to listen on; port 0 picks a free one.
    #[arg(long, value_name = "ADDR")]
    pub listen: Option<SocketAddr>,
    /// Unix socket to listen on.
    #[arg(long, value_name = "PATH")]
    pub unix: Option<PathBuf>,
    /// Simulation threads [default: one a core].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: Option<u16>,
    /// Most connections at once.
    #[arg(long, value_name = "N", default_value_t = 4096)]
    pub max_connections: usize,
    /// Most sessions open at once.
    #[arg(long, value_name = "N", default_value_t = 1024)]
    pub max_sessions: usize,
    /// Most environments in one session.
    #[arg(long, value_name = "N", default_value_t = 4096)]
    pub max_envs_per_session: usize,
    /// Close sessions without requests after this many seconds.
    #[arg(long, value_name = "SECONDS", default_value_t = 600)]
    pub session_idle: u64,
    #[command(flatten)]
    pub gl: render::GlArguments,
    /// ONNX model that makes features of agents' pictures [default: the one that ships].
    #[arg(long, value_name = "FILE")]
    pub extractor: Option<PathBuf>,
    /// Tell on stdout where it listens, as one line of JSON.
    #[arg(long)]
    pub json: bool,
}

/// `palr-gym envs`
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  palr-gym envs                  every task
  palr-gym envs hopper-w2        spaces, names and constants of one environment
  palr-gym envs hopper-w2 --json")]
pub struct EnvsArguments {
    /// Environment to describe, such as hopper-w2; without it, every task is listed.
    pub env: Option<String>,
    #[command(flatten)]
    pub server: ServerArguments,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Who plays, and from which seed.
#[derive(Debug, Args)]
pub struct PolicyArguments {
    /// Environment, such as hopper or hopper-w2.
    #[arg(long, value_name = "ID")]
    pub env: String,
    /// `expert`, `random`, an ONNX file, or the folder of a training run.
    #[arg(long, value_name = "POLICY", default_value = "expert")]
    pub policy: String,
    /// Sample actions from a stochastic policy instead of taking its mean.
    #[arg(long)]
    pub sampled: bool,
    /// Episode i is reset with seed + i.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Environments side by side [default: the server chooses].
    #[arg(long, value_name = "N")]
    pub num_envs: Option<u32>,
    #[command(flatten)]
    pub scene: scene::SceneArguments,
}

/// `palr-gym collect`
#[derive(Debug, Args)]
#[command(after_help = "\
The file has D4RL's layout and is whole or absent: what is under way lies beside it as FILE.part,
and --resume goes on with it. The expert sees the full observation; what is recorded is what the
environment shows, so name the bare task to record everything.

Examples:
  palr-gym collect --env hopper --transitions 30000 --sampled --out hopper.hdf5
  palr-gym collect --env hopper-w2 --episodes 20 --policy policy.onnx --out mine.hdf5")]
pub struct CollectArguments {
    #[command(flatten)]
    pub policy: PolicyArguments,
    /// Record exactly this many transitions; the last episode is cut [default: 30000].
    #[arg(long, value_name = "N", conflicts_with = "episodes")]
    pub transitions: Option<u64>,
    /// Record this many whole episodes.
    #[arg(long, value_name = "N")]
    pub episodes: Option<u32>,
    /// File to write.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Go on with an interrupted recording; a finished one is left as it is.
    #[arg(long, conflicts_with = "force")]
    pub resume: bool,
    /// Replace what is there.
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub server: ServerArguments,
    /// Print the result as JSON.
    #[arg(long)]
    pub json: bool,
}

/// `palr-gym evaluate`
#[derive(Debug, Args)]
#[command(after_help = "\
Scores are D4RL's: 0 is a random policy, 100 an expert. Actions outside the bounds are clipped.

Examples:
  palr-gym evaluate --env hopper --policy expert --episodes 100
  palr-gym evaluate --env hopper-w2 --policy policy.onnx --json
  palr-gym evaluate --env ant --policy random --server localhost:7257")]
pub struct EvaluateArguments {
    #[command(flatten)]
    pub policy: PolicyArguments,
    /// Episodes to play.
    #[arg(long, value_name = "N", default_value_t = 20)]
    pub episodes: u32,
    #[command(flatten)]
    pub server: ServerArguments,
    /// Print the result as JSON, every episode included.
    #[arg(long)]
    pub json: bool,
}

/// `palr-gym leakage`
#[derive(Debug, Args)]
#[command(after_help = "\
HSCIC(policy's action; expert's past action | expert's action), equation (7) of the PALR paper, exact
and in double precision, with a block-bootstrap interval (the embedding held fixed). The data set holds
full observations, as `palr-gym collect --env hopper` records them; the policy sees them as --env does.

Examples:
  palr-gym leakage --env hopper-w2 --policy policy.onnx --data hopper.hdf5
  palr-gym leakage --env hopper-w2 --policy policy.onnx --data d4rl.hdf5 --slice 900000
  palr-gym leakage --env hopper --policy expert --data hopper.hdf5 --training-rows 30000 --json")]
pub struct LeakageArguments {
    /// Environment as which the policy sees the data, such as hopper-w2.
    #[arg(long, value_name = "ID")]
    pub env: String,
    /// `expert`, `random`, an ONNX file, or the folder of a training run.
    #[arg(long, value_name = "POLICY")]
    pub policy: String,
    /// D4RL HDF5 file with full observations and actions.
    #[arg(long, value_name = "FILE")]
    pub data: PathBuf,
    /// Samples to use.
    #[arg(long, value_name = "N", default_value_t = 2000)]
    pub rows: usize,
    /// Least number of episodes to spread them over.
    #[arg(long, value_name = "N", default_value_t = 20, conflicts_with = "slice")]
    pub min_episodes: usize,
    /// Rows at the beginning of the file that were trained on and must not be used.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub training_rows: usize,
    /// Use consecutive rows from this one on, as the paper does (900000).
    #[arg(long, value_name = "ROW")]
    pub slice: Option<usize>,
    /// Take the policy's deterministic actions instead of sampling.
    #[arg(long)]
    pub deterministic: bool,
    /// λ of the ridge regression [default: 1e-5].
    #[arg(long, value_name = "λ", allow_negative_numbers = true)]
    pub ridge: Option<f64>,
    /// σ² of the kernels [default: 1].
    #[arg(long, value_name = "σ²", allow_negative_numbers = true)]
    pub bandwidth_sq: Option<f64>,
    /// Seed of sampled actions and of the bootstrap.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    #[command(flatten)]
    pub server: ServerArguments,
    /// Print the result as JSON.
    #[arg(long)]
    pub json: bool,
}

/// `palr-gym completions`
#[derive(Debug, Args)]
#[command(
    after_help = "Example: palr-gym completions bash > ~/.local/share/bash-completion/completions/palr-gym"
)]
pub struct CompletionsArguments {
    /// Which shell.
    #[arg(value_enum)]
    pub shell: clap_complete::Shell,
}
