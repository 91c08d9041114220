//! Runs that train together in one process; one run alone is the simplest case.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use tokio::sync::mpsc::UnboundedSender;

use crate::client::Client;
use crate::error::ClientError;
use crate::imitate::beside::{Beside, Turns};
use crate::imitate::records::{Metrics, Recorder};
use crate::imitate::settings::Settings;
use crate::imitate::{Event, Imitation, Outcome, recorded_steps};
use crate::learning::train::ONNX_FILE;
use crate::learning::{LockstepRun, Progress, train_lockstep};

/// Trains `runs` to their ends in lockstep, or until `is_stopped`; evaluates beside it. Each has its
/// own receiver of events; dropping one does no harm. A run has the bits that it would have alone.
///
/// # Errors
/// As [`Imitation::run`], with the folder of the run that failed if there are several. If one run
/// fails, all end: the others with a checkpoint.
pub async fn run_together(
    runs: Vec<Imitation>,
    client: &Client,
    is_stopped: Arc<AtomicBool>,
    events: Vec<UnboundedSender<Event>>,
) -> Result<Vec<Outcome>, ClientError> {
    let mut witnesses = Vec::with_capacity(runs.len());
    let turns = Turns::default();
    for (imitation, events) in runs.iter().zip(events) {
        let folder = imitation.run.folder();
        let kept = match imitation.is_resumed {
            true => Some(recorded_steps(folder)?.unwrap_or(0)),
            false => None,
        };
        let recorder = Recorder::open(folder, kept)?;
        let (client, settings) = (client.clone(), &imitation.settings);
        let beside = Beside::start(client, settings, folder, turns.clone(), events.clone())?;
        witnesses.push(Witness { recorder, beside, events, last: None });
    }
    let training = tokio::task::spawn_blocking(move || {
        let outcomes = learn(&runs, &mut witnesses, &is_stopped);
        (runs, witnesses, outcomes)
    });
    let (runs, witnesses, outcomes) = training.await.map_err(|error| ClientError::Panicked {
        what: "the trainer",
        message: error.to_string(),
    })?;
    let mut evaluations = Vec::with_capacity(runs.len());
    for (place, Witness { beside, .. }) in witnesses.into_iter().enumerate() {
        let evaluation = match &outcomes {
            // The last evaluations may still be under way; or it was one of them that failed.
            Ok(_) | Err(ClientError::EvaluationStopped { .. }) => beside.finish().await,
            Err(_) => {
                beside.abort();
                Ok(None)
            }
        };
        evaluations.push(evaluation.map_err(|cause| of_run(&runs, place, cause)));
    }
    // Nobody else may write in the folders before that.
    drop(runs);
    let evaluations: Result<Vec<_>, ClientError> = evaluations.into_iter().collect();
    match (outcomes, evaluations) {
        (Err(ClientError::EvaluationStopped { .. }), Err(cause)) => Err(cause),
        (outcomes, evaluations) => {
            let outcomes = outcomes?.into_iter().zip(evaluations?);
            Ok(outcomes.map(|(outcome, evaluation)| Outcome { evaluation, ..outcome }).collect())
        }
    }
}

/// Says which of several runs failed.
fn of_run(runs: &[Imitation], place: usize, cause: ClientError) -> ClientError {
    match (runs, cause) {
        // The evaluation that failed says why.
        ([_], cause) | (_, cause @ ClientError::EvaluationStopped { .. }) => cause,
        (runs, cause) => {
            let run_folder = runs[place].folder().to_path_buf();
            ClientError::OneOfMany { run_folder, cause: Box::new(cause) }
        }
    }
}

/// Who writes down what a run reports.
struct Witness {
    recorder: Recorder,
    beside: Beside,
    events: UnboundedSender<Event>,
    last: Option<Metrics>,
}

impl Witness {
    fn report(&mut self, settings: &Settings, progress: &Progress) -> Result<(), ClientError> {
        let metrics = Metrics::from(progress);
        self.recorder.metrics(&metrics)?;
        let every = settings.run.evaluation.every;
        let before = progress.step.saturating_sub(settings.train.log_every);
        let is_last = progress.step == progress.steps;
        if every > 0 && (progress.step / every > before / every || is_last) {
            self.beside.submit(progress.step, &progress.policy)?;
        }
        // Nobody may be watching.
        let _ = self.events.send(Event::Report(metrics.clone()));
        self.last = Some(metrics);
        Ok(())
    }
}

fn learn(
    runs: &[Imitation],
    witnesses: &mut [Witness],
    is_stopped: &AtomicBool,
) -> Result<Vec<Outcome>, ClientError> {
    let jobs: Vec<LockstepRun<'_>> = runs
        .iter()
        .map(|Imitation { run, settings, prepared, .. }| LockstepRun {
            config: &settings.train,
            data: &prepared.training,
            held_out: prepared.held_out.as_ref(),
            run_folder: run.folder(),
        })
        .collect();
    let mut failed = None;
    let trained = train_lockstep(&jobs, true, is_stopped, |place, progress| {
        match witnesses[place].report(&runs[place].settings, progress) {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                failed = Some(of_run(runs, place, error));
                ControlFlow::Break(())
            }
        }
    })?;
    if let Some(error) = failed {
        return Err(error);
    }
    let outcome = |((imitation, witness), trained): ((&Imitation, &Witness), _)| {
        let trained: crate::learning::Trained = trained;
        Outcome {
            run_folder: imitation.run.folder().to_path_buf(),
            is_complete: trained.is_complete,
            step: trained.step,
            policy: trained.is_complete.then(|| imitation.run.path(ONNX_FILE)),
            last: witness.last.clone(),
            evaluation: None,
        }
    };
    Ok(runs.iter().zip(&*witnesses).zip(trained).map(outcome).collect())
}
