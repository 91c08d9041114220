//! `palr-gym data`

mod copies;
mod histograms;
mod rows;

use faer::Mat;
use palr_gym_data::statistics::{SATURATED, Spread, Statistics, evenly_spaced_actions};
use palr_gym_data::{Part, RecordedFile, Recording};
use palr_gym_leakage::{HscicConfig, effective_dimension};
use serde::Serialize;

use crate::cli::data::{DataFileArguments, DataInfoArguments, DataSliceArguments};
use crate::cli::{DataArguments, DataCommand};
use crate::{backend, output};

/// As many rows as the paper's held-out set has; the kernel matrix is of as many squared.
const KERNEL_ROWS: usize = 2000;

/// Held-out episodes that an interval of leakage needs.
const NEEDED_EPISODES: usize = 20;

/// Numbers as they go into JSON.
#[derive(Debug, Serialize)]
struct Info {
    file: String,
    env_id: Option<String>,
    transitions: usize,
    observation_size: usize,
    action_size: usize,
    episodes: usize,
    terminated: usize,
    timed_out: usize,
    episode_return: Numbers,
    length: Numbers,
    /// After D4RL; none if no task is known.
    normalized_score: Option<Numbers>,
    actions: Vec<Action>,
    /// tr(A) of the action kernel on evenly spaced rows, at most 2000 of them.
    effective_dimension: f64,
    effective_dimension_rows: usize,
    repeated_observations: usize,
    conflicting_actions: usize,
}

#[derive(Debug, Serialize)]
struct Numbers {
    mean: f64,
    std: f64,
    min: f64,
    max: f64,
}

#[derive(Debug, Serialize)]
struct Action {
    mean: f64,
    std: f64,
    saturated: f64,
    at_bound: usize,
    lag_1_correlation: Option<f64>,
}

impl From<Spread> for Numbers {
    fn from(Spread { mean, std, min, max }: Spread) -> Self {
        Self { mean, std, min, max }
    }
}

/// What `verify` finds.
#[derive(Debug, Serialize)]
struct Finding {
    is_fine: bool,
    what: String,
}

/// Describes or checks.
pub async fn run(arguments: DataArguments) -> anyhow::Result<()> {
    match arguments.command {
        DataCommand::Info(DataInfoArguments { data, plot }) => {
            let (info, statistics) = describe(&data).await?;
            if let Some(path) = plot {
                histograms::draw(&path, &data.file, &statistics)?;
            }
            if data.json { output::json(&info) } else { print(&info) }
        }
        DataCommand::Verify(arguments) => verify(&arguments).await,
        DataCommand::Convert(arguments) => copies::run(&arguments, &Part::default()),
        DataCommand::Prepare(arguments) => rows::write(&arguments).await,
        DataCommand::Slice(arguments) => {
            let DataSliceArguments { convert, first_episode, episodes, transitions } = arguments;
            copies::run(&convert, &Part { first_episode, episodes, transitions })
        }
    }
}

async fn describe(arguments: &DataFileArguments) -> anyhow::Result<(Info, Statistics)> {
    let file = RecordedFile::open(&arguments.file)?;
    let outline = file.outline();
    let statistics = Statistics::of(&file)?;
    let env_id = arguments.env.clone().or_else(|| outline.env_id.clone());
    let lengths: Vec<f64> = statistics.lengths.iter().map(|&length| length as f64).collect();
    let scores = scores(arguments, env_id.as_deref(), &statistics.returns).await?;
    let (dimension, rows) = kernel_dimension(&file)?;
    let info = Info {
        file: arguments.file.display().to_string(),
        env_id,
        transitions: outline.transitions(),
        observation_size: outline.observation_size,
        action_size: outline.action_size,
        episodes: statistics.lengths.len(),
        terminated: statistics.terminated,
        timed_out: statistics.timed_out,
        episode_return: Spread::of(&statistics.returns).into(),
        length: Spread::of(&lengths).into(),
        normalized_score: scores.map(|scores| Spread::of(&scores).into()),
        actions: statistics
            .actions
            .iter()
            .map(|action| Action {
                mean: action.spread.mean,
                std: action.spread.std,
                saturated: action.saturated,
                at_bound: action.at_bound,
                lag_1_correlation: action.lag_1_correlation,
            })
            .collect(),
        effective_dimension: dimension,
        effective_dimension_rows: rows,
        repeated_observations: statistics.repeated_observations,
        conflicting_actions: statistics.conflicting_actions,
    };
    Ok((info, statistics))
}

/// Normalised scores, if the task is known: a name that the file itself brings may be any.
async fn scores(
    arguments: &DataFileArguments,
    env_id: Option<&str>,
    returns: &[f64],
) -> anyhow::Result<Option<Vec<f64>>> {
    let Some(env_id) = env_id else { return Ok(None) };
    let client = backend::connect(&arguments.server).await?;
    let spec = match client.spec(env_id).await {
        Ok(spec) => spec,
        Err(error) if arguments.env.is_none() && error.is_bad_request() => return Ok(None),
        Err(error) => return Err(error.into()),
    };
    let normalized = spec.reference_returns.map(|reference| {
        let width = reference.expert - reference.random;
        returns.iter().map(|value| 100.0 * (value - reference.random) / width).collect()
    });
    Ok(normalized)
}

fn kernel_dimension(file: &RecordedFile) -> anyhow::Result<(f64, usize)> {
    let actions = evenly_spaced_actions(file, KERNEL_ROWS)?;
    let rows = actions.len();
    let width = file.outline().action_size;
    let chosen = Mat::from_fn(rows, width, |i, j| f64::from(actions[i][j]));
    Ok((effective_dimension(chosen.as_ref(), &HscicConfig::default())?, rows))
}

fn print(info: &Info) -> anyhow::Result<()> {
    let numbers = |numbers: &Numbers| {
        let Numbers { mean, std, min, max } = numbers;
        format!("{mean:.1} (deviation {std:.1}, from {min:.1} to {max:.1})")
    };
    let mut rows = vec![
        ("file", info.file.clone()),
        ("environment", info.env_id.clone().unwrap_or_else(|| "not stated".into())),
        ("transitions", info.transitions.to_string()),
        ("observation, action", format!("{}, {}", info.observation_size, info.action_size)),
        (
            "episodes",
            format!(
                "{}: {} ended by the task, {} by the time limit",
                info.episodes, info.terminated, info.timed_out
            ),
        ),
        ("return", numbers(&info.episode_return)),
        ("length", numbers(&info.length)),
    ];
    if let Some(score) = &info.normalized_score {
        rows.push(("normalised score", numbers(score)));
    }
    rows.push((
        "action kernel",
        format!(
            "effective dimension {:.1} on {} rows",
            info.effective_dimension, info.effective_dimension_rows
        ),
    ));
    rows.push((
        "repeated observations",
        format!("{}, with another action {}", info.repeated_observations, info.conflicting_actions),
    ));
    for (name, value) in rows {
        println!("{name:<22} {value}");
    }
    let header = ["action", "mean", "deviation", "saturated", "exactly ±1", "lag-1 correlation"];
    let row = |(i, action): (usize, &Action)| {
        vec![
            i.to_string(),
            format!("{:.3}", action.mean),
            format!("{:.3}", action.std),
            format!("{:.1} %", 100.0 * action.saturated),
            action.at_bound.to_string(),
            action.lag_1_correlation.map_or_else(|| "–".into(), |value| format!("{value:.3}")),
        ]
    };
    println!("{}", output::table(&header, info.actions.iter().enumerate().map(row).collect(), 1));
    Ok(())
}

async fn verify(arguments: &DataFileArguments) -> anyhow::Result<()> {
    // Layout, lengths, NaN and bounds are checked by reading.
    let (info, _) = describe(arguments).await?;
    let saturated = info.actions.iter().map(|action| action.saturated).fold(0.0, f64::max);
    let at_bound: usize = info.actions.iter().map(|action| action.at_bound).sum();
    let constant = info.actions.iter().filter(|action| action.std == 0.0).count();
    let finding = |is_fine: bool, what: String| Finding { is_fine, what };
    let findings = [
        finding(true, format!("{} transitions, finite and within bounds", info.transitions)),
        finding(
            info.episodes > NEEDED_EPISODES,
            format!(
                "{} episodes; more than {NEEDED_EPISODES} are needed, to train on some and hold \
                 {NEEDED_EPISODES} out for an interval",
                info.episodes
            ),
        ),
        finding(constant == 0, format!("{constant} entries of the action never vary")),
        finding(
            at_bound == 0,
            format!("{at_bound} actions are exactly ±1, where a tanh policy has no likelihood"),
        ),
        finding(
            saturated < 0.2,
            format!("at most {:.1} % of an entry is beyond ±{SATURATED}", 100.0 * saturated),
        ),
        finding(
            info.conflicting_actions == 0,
            format!(
                "{} of {} repeated observations come with another action",
                info.conflicting_actions, info.repeated_observations
            ),
        ),
    ];
    if arguments.json {
        output::json(&findings)?;
    } else {
        for finding in &findings {
            println!("{:<5} {}", if finding.is_fine { "ok" } else { "WRONG" }, finding.what);
        }
    }
    let wrong = findings.iter().filter(|finding| !finding.is_fine).count();
    anyhow::ensure!(wrong == 0, "{}: {wrong} findings", arguments.file.display());
    Ok(())
}
