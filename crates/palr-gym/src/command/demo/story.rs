//! What a demo measured, as a table, a sentence and a figure.

use std::path::Path;

use comfy_table::Table;
use palr_gym_trainer::ClientError;
use palr_gym_trainer::collect::Collected;
use palr_gym_trainer::evaluate::Evaluation;
use palr_gym_trainer::imitate::manifest::Manifest;
use palr_gym_trainer::imitate::records::{
    EVALUATIONS_FILE, EvaluationRecord, METRICS_FILE, Metrics, read_lines,
};
use palr_gym_trainer::leakage::Leakage;
use palr_gym_trainer::plot::{Panel, Point, Series, figure};
use serde::{Deserialize, Serialize};

use crate::output;

/// Everything that a demo measured.
#[derive(Debug, Serialize)]
pub struct Results {
    pub data: Collected,
    pub players: Vec<Player>,
}

/// One policy.
#[derive(Debug, Serialize, Deserialize)]
pub struct Player {
    pub name: String,
    pub evaluation: Evaluation,
    pub leakage: Leakage,
    /// If it was trained.
    pub training: Option<Training>,
}

/// How a policy came about.
#[derive(Debug, Serialize, Deserialize)]
pub struct Training {
    pub manifest: Manifest,
    pub metrics: Vec<Metrics>,
    pub evaluations: Vec<EvaluationRecord>,
}

impl Player {
    /// One that nobody trained here.
    pub fn given(name: &str, evaluation: Evaluation, leakage: Leakage) -> Self {
        Self { name: name.to_owned(), evaluation, leakage, training: None }
    }

    /// One whose run lies in `folder`.
    pub fn trained(
        name: &str,
        evaluation: Evaluation,
        leakage: Leakage,
        folder: &Path,
        manifest: Manifest,
    ) -> Result<Self, ClientError> {
        let metrics = read_lines(&folder.join(METRICS_FILE))?;
        let evaluations = read_lines(&folder.join(EVALUATIONS_FILE))?;
        let training = Training { manifest, metrics, evaluations };
        Ok(Self { training: Some(training), ..Self::given(name, evaluation, leakage) })
    }

    /// Mean log-likelihood of held-out actions, in nats.
    fn held_out_likelihood(&self) -> Option<f64> {
        self.training.as_ref()?.metrics.last()?.held_out_nll.map(|nll| -nll)
    }
}

impl Results {
    /// A row for each policy.
    pub fn table(&self) -> Table {
        let header = [
            "policy",
            "return",
            "± SE",
            "score",
            "± SE",
            "held-out log-likelihood",
            "leakage: HSCIC [95 %]",
        ];
        let optional = |value: Option<f64>, digits: usize| {
            value.map_or_else(|| "–".to_owned(), |value| format!("{value:.digits$}"))
        };
        let row = |player: &Player| {
            let (evaluation, leakage) = (&player.evaluation, &player.leakage);
            let (low, high) = leakage.hscic_interval;
            vec![
                player.name.clone(),
                format!("{:.1}", evaluation.return_mean),
                optional(evaluation.return_standard_error, 1),
                format!("{:.1}", evaluation.score_mean),
                optional(evaluation.score_standard_error, 1),
                optional(player.held_out_likelihood(), 3),
                format!("{:.2e} [{low:.2e}, {high:.2e}]", leakage.hscic),
            ]
        };
        output::table(&header, self.players.iter().map(row).collect(), 1)
    }

    /// What the table says, and no more.
    pub fn reading(&self) -> String {
        let find = |name: &str| self.players.iter().find(|player| player.name == name);
        let (Some(bc), Some(palr)) = (find("bc"), find("palr")) else { return String::new() };
        let score = |player: &Player| {
            let mean = player.evaluation.score_mean;
            let se = player.evaluation.score_standard_error.unwrap_or(f64::NAN);
            (mean, se)
        };
        let ((bc_mean, bc_se), (palr_mean, palr_se)) = (score(bc), score(palr));
        let (difference, se) = (palr_mean - bc_mean, bc_se.hypot(palr_se));
        let (bc_low, bc_high) = bc.leakage.hscic_interval;
        let (palr_low, palr_high) = palr.leakage.hscic_interval;
        let leakage = if palr_high < bc_low {
            "leaks less (the intervals are apart)"
        } else if bc_high < palr_low {
            "leaks more (the intervals are apart)"
        } else {
            "does not leak measurably less or more (the intervals overlap)"
        };
        format!(
            "Here, with one seed, PALR scores {difference:+.1} ± {se:.1} against BC, and its action\n\
             {leakage}. PALR took its weight matrices\n\
             from a pool; the paper computes one each step. One seed and few steps are no result."
        )
    }

    /// Curves, and leakage against score.
    pub fn draw(&self, path: &Path, title: &str) -> Result<(), ClientError> {
        let curves = |points: &dyn Fn(&Training) -> Vec<Point>| -> Vec<Series> {
            let trained = self.players.iter().filter_map(|player| {
                let points = points(player.training.as_ref()?);
                Some(Series { label: player.name.clone(), points, is_curve: true })
            });
            trained.collect()
        };
        let metric = |of: fn(&Metrics) -> Option<f64>| {
            curves(&|training| {
                let point = |m: &Metrics| Some(Point::new(m.step as f64, of(m)?));
                training.metrics.iter().filter_map(point).collect()
            })
        };
        let scores = curves(&|training| training.evaluations.iter().map(score_point).collect());
        let panel = |title: &str, x_label: &str, y_label: &str, is_y_log, series| Panel {
            title: title.into(),
            x_label: x_label.into(),
            y_label: y_label.into(),
            is_y_log,
            series,
        };
        let players = self.players.iter().map(|player| Series {
            label: player.name.clone(),
            points: vec![player_point(player)],
            is_curve: false,
        });
        let steps = "steps";
        let panels = [
            panel("evaluation beside training", steps, "score ± SE", false, scores),
            panel(
                "held-out log-likelihood",
                steps,
                "nats",
                false,
                metric(|m| m.held_out_nll.map(|nll| -nll)),
            ),
            panel(
                "leakage of the representation, held out",
                steps,
                "HSCIC",
                true,
                metric(|m| m.held_out_hscic),
            ),
            panel(
                "leakage of the action against score",
                "score ± SE",
                "HSCIC, 95 %",
                false,
                players.collect(),
            ),
        ];
        figure(path, title, &panels)
    }
}

fn score_point(record: &EvaluationRecord) -> Point {
    let around = |se: f64| (record.score_mean - se, record.score_mean + se);
    Point {
        y_interval: record.score_standard_error.map(around),
        ..Point::new(record.step as f64, record.score_mean)
    }
}

fn player_point(player: &Player) -> Point {
    let score = player.evaluation.score_mean;
    let around = |se: f64| (score - se, score + se);
    Point {
        x: score,
        y: player.leakage.hscic,
        x_interval: player.evaluation.score_standard_error.map(around),
        y_interval: Some(player.leakage.hscic_interval),
    }
}
