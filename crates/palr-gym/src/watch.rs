//! What a person sees of a training run: a bar on a terminal, lines elsewhere.

use std::io::IsTerminal;

use indicatif::{MultiProgress, ProgressBar};
use palr_gym_trainer::imitate::Event;
use palr_gym_trainer::imitate::records::{EvaluationRecord, Metrics};
use tokio::sync::mpsc::UnboundedReceiver;

use crate::progress;

/// One run, watched.
pub struct Watch {
    label: String,
    steps: u64,
    bar: ProgressBar,
    has_lines: bool,
    score: Option<EvaluationRecord>,
}

impl Watch {
    /// Shows nothing if `is_quiet` and stderr is no terminal.
    pub fn new(label: &str, steps: u64, is_quiet: bool) -> Self {
        let bar = progress::bar(label, steps, "steps");
        let has_lines = !is_quiet && !std::io::stderr().is_terminal();
        Self { label: label.to_owned(), steps, bar, has_lines, score: None }
    }

    /// The same beside others.
    pub fn among(self, bars: &MultiProgress) -> Self {
        Self { bar: bars.add(self.bar), ..self }
    }

    /// Shows what comes until the run ends.
    pub async fn follow(mut self, mut events: UnboundedReceiver<Event>) {
        while let Some(event) = events.recv().await {
            match event {
                Event::Report(metrics) => self.report(&metrics),
                Event::Evaluation(record) => self.evaluation(record),
            }
        }
        self.bar.finish_and_clear();
    }

    fn report(&mut self, metrics: &Metrics) {
        let (nll, hscic, rows) = match (metrics.held_out_nll, metrics.held_out_hscic) {
            (Some(nll), Some(hscic)) => (nll, hscic, "held-out"),
            _ => (metrics.training_nll, metrics.training_hscic, "training"),
        };
        let score = self.score.as_ref().map(|record| format!(" · score {:.1}", record.score_mean));
        let text = format!(
            "· {rows} log-likelihood {:.3}, HSCIC {hscic:.2e}{}",
            -nll,
            score.unwrap_or_default()
        );
        self.bar.set_position(metrics.step);
        if self.has_lines {
            eprintln!("{:>6} {:>7}/{} {text}", self.label, metrics.step, self.steps);
        }
        self.bar.set_message(text);
    }

    fn evaluation(&mut self, record: EvaluationRecord) {
        if self.has_lines {
            let se = record.score_standard_error;
            eprintln!(
                "{:>6} {:>7}/{} · evaluated: return {:.1}, score {:.1}{}",
                self.label,
                record.step,
                self.steps,
                record.return_mean,
                record.score_mean,
                se.map(|se| format!(" ± {se:.1}")).unwrap_or_default(),
            );
        }
        self.score = Some(record);
    }
}
