//! The binary `palr-gym`: arguments in, exit codes out; the work is done elsewhere.
//!
//! Exit codes: 0 done, 1 failed, 64 the command line or the request was wrong, 130 interrupted.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a command line program prints")]
#![allow(unreachable_pub, reason = "a binary has no outside")]

mod backend;
mod build;
mod cli;
mod command;
mod interrupt;
mod movie;
mod output;
mod progress;
mod watch;

use std::io::IsTerminal;
use std::process::ExitCode;

use clap::Parser;
use palr_gym_trainer::ClientError;
use tracing_subscriber::EnvFilter;

use crate::cli::{Cli, Command, LogFormat};
use crate::interrupt::{EXIT_INTERRUPTED, Interrupted};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

const EXIT_FAILURE: u8 = 1;
const EXIT_USAGE: u8 = 64;

fn main() -> ExitCode {
    // Before there is any other thread.
    palr_gym_sim::render::prepare_process();
    // Before any thread can use MuJoCo.
    palr_gym_sim::mujoco_log::route_to_log();
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => {
            // It fails only if the terminal is gone.
            let _ = error.print();
            return if error.use_stderr() { EXIT_USAGE.into() } else { ExitCode::SUCCESS };
        }
    };
    start_logging(&cli);
    let runtime = match tokio::runtime::Builder::new_multi_thread().enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => {
            eprintln!("error: cannot start the runtime: {error}");
            return EXIT_FAILURE.into();
        }
    };
    let result = runtime.block_on(run(cli));
    palr_gym_sim::threads::before_exit();
    // Rollouts that nobody reads any more end on their own; do not wait for them.
    runtime.shutdown_background();
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if error.is::<Interrupted>() => {
            eprintln!("{error}");
            EXIT_INTERRUPTED.into()
        }
        Err(error) => {
            eprintln!("error: {error:#}");
            let is_usage =
                error.downcast_ref::<ClientError>().is_some_and(ClientError::is_bad_request);
            if is_usage { EXIT_USAGE.into() } else { EXIT_FAILURE.into() }
        }
    }
}

async fn run(cli: Cli) -> anyhow::Result<()> {
    match cli.command {
        Command::Serve(arguments) => command::serve::run(arguments).await,
        Command::Envs(arguments) => command::envs::run(arguments).await,
        Command::Collect(arguments) => command::collect::run(arguments).await,
        Command::Evaluate(arguments) => command::evaluate::run(arguments).await,
        Command::Render(arguments) => command::render::run(arguments).await,
        Command::Train(arguments) => command::train::run(*arguments).await,
        Command::Expert(arguments) => command::expert::run(arguments).await,
        Command::Data(arguments) => command::data::run(arguments).await,
        Command::Runs(arguments) => command::runs::list(&arguments),
        Command::Plot(arguments) => command::runs::plot(&arguments),
        Command::Leakage(arguments) => command::leakage::run(arguments).await,
        Command::Bench(arguments) => command::bench::run(arguments).await,
        Command::Demo(arguments) => command::demo::run(arguments).await,
        Command::Completions(arguments) => {
            command::completions::run(&arguments);
            Ok(())
        }
    }
}

/// Logs go to stderr; stdout is for results.
fn start_logging(cli: &Cli) {
    let default = if matches!(cli.command, Command::Serve(_)) {
        "info,mujoco=warn"
    } else {
        "warn,mujoco=error"
    };
    let filter =
        EnvFilter::try_from_env("PALR_GYM_LOG").unwrap_or_else(|_| EnvFilter::new(default));
    let subscriber = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal());
    match cli.log_format {
        LogFormat::Text => subscriber.init(),
        LogFormat::Json => subscriber.json().init(),
    }
}
