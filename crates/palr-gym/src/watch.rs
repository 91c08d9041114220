//! What a person sees of a training run: a view that lives on a terminal, lines elsewhere.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{HumanDuration, MultiProgress, ProgressBar, ProgressStyle};
use palr_gym_trainer::imitate::Event;
use palr_gym_trainer::imitate::records::{EvaluationRecord, Metrics};
use tokio::sync::mpsc::UnboundedReceiver;

/// Weight of the newest report in the speed that is shown.
const NEWEST: f64 = 0.3;

/// One run, watched.
pub struct Watch {
    label: String,
    bar: ProgressBar,
    /// There is a terminal, and room for more than a line.
    is_tall: bool,
    has_lines: bool,
    pace: Pace,
    score: Option<EvaluationRecord>,
}

/// How quickly a run goes on.
#[derive(Debug)]
struct Pace {
    steps: u64,
    last: Option<(Instant, u64)>,
    steps_per_s: Option<f64>,
}

impl Pace {
    /// Takes in that `step` steps were taken `now`.
    fn take(&mut self, now: Instant, step: u64) {
        if let Some((before, from)) = self.last {
            let elapsed_s = now.saturating_duration_since(before).as_secs_f64();
            let newest = step.saturating_sub(from) as f64 / elapsed_s.max(1e-9);
            self.steps_per_s = Some(match self.steps_per_s {
                Some(steps_per_s) => (1.0 - NEWEST) * steps_per_s + NEWEST * newest,
                None => newest,
            });
        }
        self.last = Some((now, step));
    }

    /// Steps a second and the time that is left; nothing after one report.
    fn text(&self) -> Option<String> {
        let (steps_per_s, (_, step)) = (self.steps_per_s?, self.last?);
        let left_s = self.steps.saturating_sub(step) as f64 / steps_per_s.max(1e-9);
        let left = Duration::try_from_secs_f64(left_s.round()).unwrap_or(Duration::MAX);
        Some(format!("{steps_per_s:.1} steps/s, {} left", HumanDuration(left)))
    }
}

impl Watch {
    /// Shows nothing if `is_quiet` and stderr is no terminal.
    pub fn new(label: &str, steps: u64, is_quiet: bool) -> Self {
        let is_terminal = std::io::stderr().is_terminal();
        let bar = ProgressBar::new(steps).with_prefix(label.to_owned());
        bar.enable_steady_tick(Duration::from_millis(200));
        let pace = Pace { steps, last: None, steps_per_s: None };
        let label = label.to_owned();
        let has_lines = !is_quiet && !is_terminal;
        Self { label, bar, is_tall: is_terminal, has_lines, pace, score: None }
    }

    /// The same beside others: a line each.
    pub fn among(self, bars: &MultiProgress) -> Self {
        Self { bar: bars.add(self.bar), is_tall: false, ..self }
    }

    /// Shows what comes until the run ends.
    pub async fn follow(mut self, mut events: UnboundedReceiver<Event>) {
        let template = if self.is_tall {
            "{prefix:>8} {bar:40.cyan/dim} {human_pos}/{human_len} steps, {elapsed} so far{msg}"
        } else {
            "{prefix:>14} {bar:24.cyan/dim} {human_pos}/{human_len} {msg}"
        };
        let style = ProgressStyle::with_template(template);
        let style = style.unwrap_or_else(|_| ProgressStyle::default_bar());
        self.bar.set_style(style.progress_chars("━╸─"));
        while let Some(event) = events.recv().await {
            match event {
                Event::Report(metrics) => self.report(&metrics),
                Event::Evaluation(record) => self.evaluation(record),
            }
        }
        self.bar.finish_and_clear();
    }

    fn report(&mut self, metrics: &Metrics) {
        self.pace.take(Instant::now(), metrics.step);
        self.bar.set_position(metrics.step);
        let pace = self.pace.text();
        let score = self.score.as_ref();
        if self.has_lines {
            let text = line(metrics, pace.as_deref(), score);
            eprintln!("{:>6} {:>7}/{} {text}", self.label, metrics.step, self.pace.steps);
        }
        self.bar.set_message(match self.is_tall {
            true => tall(metrics, pace.as_deref(), score),
            false => line(metrics, pace.as_deref(), score),
        });
    }

    fn evaluation(&mut self, record: EvaluationRecord) {
        if self.has_lines {
            eprintln!(
                "{:>6} {:>7}/{} · evaluated: return {:.1}, score {}",
                self.label,
                record.step,
                self.pace.steps,
                record.return_mean,
                score_text(&record),
            );
        }
        self.score = Some(record);
    }
}

fn score_text(record: &EvaluationRecord) -> String {
    let error = record.score_standard_error.map(|error| format!(" ± {error:.1}"));
    format!("{:.1}{}", record.score_mean, error.unwrap_or_default())
}

/// On which rows, -log-likelihood, HSCIC of the representation and of the action.
fn measured(metrics: &Metrics) -> (&'static str, f64, f64, f64) {
    match (metrics.held_out_nll, metrics.held_out_hscic, metrics.held_out_action_hscic) {
        (Some(nll), Some(hscic), Some(action)) => ("held-out", nll, hscic, action),
        _ => {
            let Metrics { training_nll, training_hscic, training_action_hscic, .. } = metrics;
            ("training", *training_nll, *training_hscic, *training_action_hscic)
        }
    }
}

/// A report in a line.
fn line(metrics: &Metrics, pace: Option<&str>, score: Option<&EvaluationRecord>) -> String {
    let (rows, nll, hscic, action) = measured(metrics);
    let mut text = format!(
        "· {rows} log-likelihood {:.3}, HSCIC {hscic:.2e}, of the action {action:.2e}",
        -nll
    );
    if let Some(score) = score {
        text += &format!(" · score {:.1}", score.score_mean);
    }
    if let Some(pace) = pace {
        text += &format!(" · {pace}");
    }
    text
}

/// A report below the bar, a line a subject.
fn tall(metrics: &Metrics, pace: Option<&str>, score: Option<&EvaluationRecord>) -> String {
    let (rows, nll, hscic, action) = measured(metrics);
    let mut lines = vec![String::new()];
    let mut add = |name: &str, text: String| lines.push(format!("{name:>18}  {text}"));
    if let Some(pace) = pace {
        add("pace", pace.to_owned());
    }
    let mut likelihood = format!("{:.3} {rows}", -nll);
    if rows == "held-out" {
        likelihood += &format!(", {:.3} training", -metrics.training_nll);
    }
    if let Some(change_nll) = metrics.held_out_change_nll {
        likelihood += &format!(", {:.3} where actions change", -change_nll);
    }
    add("log-likelihood", likelihood);
    add("HSCIC", format!("{hscic:.3e} representation, {action:.3e} action ({rows})"));
    if let Some(score) = score {
        add("score", format!("{} at step {}", score_text(score), score.step));
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn metrics() -> Metrics {
        serde_json::from_value(serde_json::json!({
            "step": 500, "batch_nll": 1.0, "batch_hscic": null, "training_nll": -1.5,
            "training_hscic": 0.01, "training_action_hscic": 0.02, "held_out_nll": -1.25,
            "held_out_hscic": 0.03, "held_out_action_hscic": 0.04, "held_out_change_nll": 2.0,
        }))
        .unwrap_or_else(|error| panic!("{error}"))
    }

    #[test]
    fn speed_and_time_left_follow_from_reports() {
        let start = Instant::now();
        let mut pace = Pace { steps: 1000, last: None, steps_per_s: None };
        pace.take(start, 100);
        assert_eq!(pace.text(), None);
        pace.take(start + Duration::from_secs(10), 200);
        assert_eq!(pace.text().as_deref(), Some("10.0 steps/s, 80 seconds left"));
        // A quicker report counts in part.
        pace.take(start + Duration::from_secs(15), 300);
        assert_eq!(pace.text().as_deref(), Some("13.0 steps/s, 54 seconds left"));
    }

    #[test]
    fn a_report_shows_likelihood_leakage_and_score() {
        let score = EvaluationRecord {
            step: 400,
            episodes: 5,
            seed: 0,
            return_mean: 1.0,
            return_standard_error: None,
            score_mean: 71.04,
            score_standard_error: Some(2.5),
            length_mean: 1.0,
        };
        let text = line(&metrics(), Some("9.0 steps/s, 1 minute left"), Some(&score));
        let want = "· held-out log-likelihood 1.250, HSCIC 3.00e-2, of the action 4.00e-2 \
            · score 71.0 · 9.0 steps/s, 1 minute left";
        assert_eq!(text, want);
        let text = tall(&metrics(), None, Some(&score));
        for part in [
            "log-likelihood  1.250 held-out, 1.500 training, -2.000 where actions change",
            "HSCIC  3.000e-2 representation, 4.000e-2 action (held-out)",
            "score  71.0 ± 2.5 at step 400",
        ] {
            assert!(text.contains(part), "{text}");
        }
        let without = Metrics { held_out_nll: None, held_out_change_nll: None, ..metrics() };
        assert!(
            line(&without, None, None).contains("training log-likelihood 1.500, HSCIC 1.00e-2")
        );
    }
}
