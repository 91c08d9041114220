//! `palr-gym bench`

use indicatif::ProgressBar;
use palr_gym_trainer::Client;
use palr_gym_trainer::benchmark::{
    BenchmarkOptions, Latency, StepLatencies, StepRates, Subject, step_latencies, step_rates,
};

use crate::cli::bench::{
    BenchArguments, BenchCommand, BenchCommonArguments, BenchLatencyArguments, BenchStepArguments,
};
use crate::{backend, output, progress};

/// Measures and prints.
pub async fn run(arguments: BenchArguments) -> anyhow::Result<()> {
    match arguments.what {
        BenchCommand::Step(arguments) => run_step(&arguments).await,
        BenchCommand::Latency(arguments) => run_latency(&arguments).await,
    }
}

async fn run_step(arguments: &BenchStepArguments) -> anyhow::Result<()> {
    let (client, options, bar) = prepare(&arguments.common, arguments.num_envs).await?;
    let measured = step_rates(&client, &options, arguments.in_flight, |elapsed| {
        bar.set_position(elapsed.as_millis() as u64);
    })
    .await;
    bar.finish_and_clear();
    let rates = measured?;
    if arguments.common.json {
        return output::json(&rates);
    }
    println!("{}", rates_table(&rates));
    Ok(())
}

async fn run_latency(arguments: &BenchLatencyArguments) -> anyhow::Result<()> {
    let (client, options, bar) = prepare(&arguments.common, arguments.num_envs).await?;
    let measured = step_latencies(&client, &options, |elapsed| {
        bar.set_position(elapsed.as_millis() as u64);
    })
    .await;
    bar.finish_and_clear();
    let latencies = measured?;
    if arguments.common.json {
        return output::json(&latencies);
    }
    println!("{}", latencies_table(&latencies));
    Ok(())
}

async fn prepare(
    common: &BenchCommonArguments,
    num_envs: u32,
) -> anyhow::Result<(Client, BenchmarkOptions, ProgressBar)> {
    let client = backend::connect(&common.server).await?;
    let options = BenchmarkOptions {
        env_id: common.env.clone(),
        num_envs,
        duration: common.seconds,
        repeats: common.repeats,
        seed: common.seed,
    };
    let total_ms = (options.duration * options.repeats).as_millis() as u64;
    Ok((client, options, progress::bar("bench", total_ms, "ms")))
}

/// The columns that both tables begin with.
const SUBJECT: [&str; 4] = ["server", "threads", "environment", "envs"];

fn subject_cells(subject: &Subject) -> Vec<String> {
    vec![
        subject.server_version.clone(),
        subject.simulation_threads.to_string(),
        subject.env_id.clone(),
        subject.num_envs.to_string(),
    ]
}

fn rates_table(rates: &StepRates) -> comfy_table::Table {
    let all = || rates.repeats.iter().map(|repeat| repeat.steps_per_s);
    let (low, high) = (all().fold(f64::INFINITY, f64::min), all().fold(0.0, f64::max));
    let mut row = subject_cells(&rates.subject);
    row.extend([
        rates.in_flight.to_string(),
        format!("{:.0}", rates.steps_per_s),
        format!("{low:.0} to {high:.0}"),
    ]);
    let header = [&SUBJECT[..], &["in flight", "steps/s (median)", "all repeats"]].concat();
    output::table(&header, vec![row], 3)
}

fn latencies_table(latencies: &StepLatencies) -> comfy_table::Table {
    let row = |name: &str, latency: &Latency| {
        let values =
            [latency.p50_us, latency.p90_us, latency.p99_us, latency.max_us, latency.mean_us];
        let mut row = subject_cells(&latencies.subject);
        row.extend([name.to_owned(), latency.count.to_string()]);
        row.extend(values.map(|value| format!("{value:.1}")));
        row
    };
    let rows = vec![row("step", &latencies.step), row("empty call", &latencies.empty_call)];
    let columns = ["round trip", "count", "p50 µs", "p90 µs", "p99 µs", "max µs", "mean µs"];
    output::table(&[&SUBJECT[..], &columns[..]].concat(), rows, 5)
}
