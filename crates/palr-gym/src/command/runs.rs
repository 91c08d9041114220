//! `palr-gym runs` and `palr-gym plot`

use palr_gym_trainer::imitate::summary::{RunSummary, differing_settings, find, group, panels};
use palr_gym_trainer::plot::figure;

use crate::cli::{PlotArguments, RunsArguments};
use crate::output;

/// Lists runs and what sets them apart.
pub fn list(arguments: &RunsArguments) -> anyhow::Result<()> {
    let runs = find(&arguments.folders)?;
    if arguments.json {
        return output::json(&runs);
    }
    let differing = differing_settings(&runs);
    let header = ["run", "environment", "algorithm", "seed"]
        .into_iter()
        .chain(differing.iter().map(String::as_str))
        .chain(["step", "state", "log-likelihood", "HSCIC", "score", "± SE"]);
    let header: Vec<&str> = header.collect();
    let rows = runs.iter().map(|run| row(run, &differing)).collect();
    println!("{}", output::table(&header, rows, 3));
    Ok(())
}

fn row(run: &RunSummary, differing: &[String]) -> Vec<String> {
    let none = || "–".to_owned();
    let setting = |name: &str| run.setting(name).unwrap_or_else(none);
    let (metrics, evaluation) = (run.metrics.last(), run.evaluations.last());
    let step = metrics.map_or(0, |metrics| metrics.step);
    let likelihood =
        metrics.map(|m| measured(m.held_out_nll, m.training_nll, |nll| format!("{:.3}", -nll)));
    let hscic = metrics
        .map(|m| measured(m.held_out_hscic, m.training_hscic, |value| format!("{value:.2e}")));
    let score = evaluation.map(|record| format!("{:.1}", record.score_mean));
    let error = evaluation.and_then(|record| record.score_standard_error);
    let mut cells = vec![
        run.folder.display().to_string(),
        run.manifest.env_id.clone(),
        setting("algorithm"),
        setting("seed"),
    ];
    cells.extend(differing.iter().map(|name| setting(name)));
    cells.extend([
        step.to_string(),
        if run.is_complete { "complete" } else { "unfinished" }.to_owned(),
        likelihood.unwrap_or_else(none),
        hscic.unwrap_or_else(none),
        score.unwrap_or_else(none),
        error.map_or_else(none, |error| format!("{error:.1}")),
    ]);
    cells
}

/// A number on held-out rows; on those that were trained on, if there are no others, and marked.
fn measured(held_out: Option<f64>, training: f64, format: impl Fn(f64) -> String) -> String {
    held_out.map_or_else(|| format!("{} (training)", format(training)), &format)
}

/// Draws the curves of runs.
pub fn plot(arguments: &PlotArguments) -> anyhow::Result<()> {
    let groups = group(find(&arguments.folders)?);
    let count: usize = groups.iter().map(|group| group.runs.len()).sum();
    let env_id = groups.first().and_then(|group| group.runs.first());
    let env_id = env_id.map(|run| run.manifest.env_id.clone()).unwrap_or_default();
    let title = arguments.title.clone().unwrap_or_else(|| format!("{env_id}: {count} runs"));
    figure(&arguments.out, &title, &panels(&groups))?;
    println!("{} and .png", arguments.out.with_extension("svg").display());
    Ok(())
}
