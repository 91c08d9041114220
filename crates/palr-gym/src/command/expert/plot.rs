//! `palr-gym expert plot`

use anyhow::{Context, ensure};
use palr_gym_trainer::ClientError;
use palr_gym_trainer::expert::card::{CARD_FILE, Card};
use palr_gym_trainer::plot::{Panel, Point, Series, figure};

use crate::cli::expert::ExpertPlotArguments;

/// Draws how the returns of experts grew, a panel each.
pub fn run(arguments: &ExpertPlotArguments) -> anyhow::Result<()> {
    let mut panels = Vec::new();
    for path in &arguments.cards {
        let path = if path.is_dir() { path.join(CARD_FILE) } else { path.clone() };
        let bytes = std::fs::read(&path).map_err(|error| ClientError::file(&path, error))?;
        let card: Card = serde_json::from_slice(&bytes).with_context(|| {
            format!("{} is no model card; `palr-gym expert card` writes one", path.display())
        })?;
        ensure!(
            !card.curve.is_empty(),
            "{} tells no curve; expected an evaluation at least",
            path.display()
        );
        panels.push(panel(&card));
    }
    figure(&arguments.out, "Experts: return of the mean action", &panels)?;
    let out = arguments.out.with_extension("svg");
    println!("{} and .png", out.display());
    Ok(())
}

fn panel(card: &Card) -> Panel {
    let million = |steps: u64| steps as f64 / 1e6;
    let points = card.curve.iter().map(|&(step, value)| Point::new(million(step), value));
    let kept = Point::new(million(card.step), card.deterministic.return_mean);
    Panel {
        title: format!("{} (score {:.1})", card.env, card.deterministic.score_mean),
        x_label: "transitions (millions)".into(),
        y_label: "return".into(),
        is_y_log: false,
        series: vec![
            Series { label: "while training".into(), points: points.collect(), is_curve: true },
            Series {
                label: "the kept one, measured anew".into(),
                points: vec![kept],
                is_curve: false,
            },
        ],
    }
}
