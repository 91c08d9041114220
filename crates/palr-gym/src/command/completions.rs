//! `palr-gym completions`

use clap::CommandFactory;

use crate::cli::{Cli, CompletionsArguments};

/// Prints the script.
pub fn run(arguments: &CompletionsArguments) {
    clap_complete::generate(
        arguments.shell,
        &mut Cli::command(),
        "palr-gym",
        &mut std::io::stdout(),
    );
}
