//! Results on stdout: tables for people, JSON for programs.

use comfy_table::presets::UTF8_FULL_CONDENSED;
use comfy_table::{CellAlignment, Table};
use palr_gym_trainer::evaluate::Evaluation;
use serde::Serialize;

/// Prints a value as JSON.
pub fn json(value: &impl Serialize) -> anyhow::Result<()> {
    println!("{}", serde_json::to_string_pretty(value)?);
    Ok(())
}

/// A table with `header`, numbers to the right from column `first_number` on.
pub fn table(header: &[&str], rows: Vec<Vec<String>>, first_number: usize) -> Table {
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED).set_header(header);
    for row in rows {
        table.add_row(row);
    }
    for index in first_number..header.len() {
        if let Some(column) = table.column_mut(index) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    table
}

/// One row for each evaluation.
pub fn evaluation_table(evaluations: &[Evaluation]) -> Table {
    let header = [
        "policy",
        "environment",
        "episodes",
        "return",
        "± SE",
        "score",
        "± SE",
        "score IQM [95 %]",
        "length",
        "steps/s",
    ];
    let rows = evaluations
        .iter()
        .map(|evaluation| {
            let (low, high) = evaluation.score_interquartile_mean_interval;
            vec![
                evaluation.policy.clone(),
                evaluation.env_id.clone(),
                evaluation.episodes.len().to_string(),
                format!("{:.1}", evaluation.return_mean),
                optional(evaluation.return_standard_error),
                format!("{:.1}", evaluation.score_mean),
                optional(evaluation.score_standard_error),
                format!("{:.1} [{low:.1}, {high:.1}]", evaluation.score_interquartile_mean),
                format!("{:.1}", evaluation.length_mean),
                format!("{:.0}", evaluation.steps_per_s()),
            ]
        })
        .collect();
    table(&header, rows, 2)
}

fn optional(value: Option<f64>) -> String {
    value.map_or_else(|| "–".to_owned(), |value| format!("{value:.1}"))
}
