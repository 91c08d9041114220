//! Many runs in one process, one step of each at a time.
//!
//! M of a step follows from the actions of its batch. Runs that draw the same batches, such as those
//! with other seeds, another α or another frame stack, need one M a step between them, and it is
//! most of what a step of PALR costs. It is computed for the next step while this one is trained.

use std::collections::HashSet;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use crate::learning::config::TrainConfig;
use crate::learning::data::TrainingSet;
use crate::learning::error::TrainError;
use crate::learning::regularizer::SharedWeights;
use crate::learning::train::{Progress, Trained, Trainer};

/// One of the runs.
#[derive(Debug, Clone, Copy)]
pub struct LockstepRun<'a> {
    /// What decides its bits.
    pub config: &'a TrainConfig,
    /// What it learns from.
    pub data: &'a TrainingSet,
    /// For reports of progress.
    pub held_out: Option<&'a TrainingSet>,
    /// Holds the run; no other run's.
    pub run_folder: &'a Path,
}

/// Trains all `runs`, each as [`train`](crate::learning::train::train) would: a run has the same
/// bits alone. They must draw the same batches: equal `batch_seed`, `batch` and number of rows.
///
/// `on_progress` is told the run's place. If it breaks, or once `is_stopped` is true, all runs end
/// with a checkpoint. Runs that were resumed at different steps are brought together first.
///
/// # Errors
/// [`TrainError::Setting`] for runs that do not draw the same batches or share a folder; any
/// [`TrainError`] of a run, which [`TrainError::OneOfMany`] names if it is not alone: then the others
/// leave a checkpoint.
pub fn train_lockstep(
    runs: &[LockstepRun<'_>],
    resume: bool,
    is_stopped: &AtomicBool,
    mut on_progress: impl FnMut(usize, &Progress) -> ControlFlow<()>,
) -> Result<Vec<Trained>, TrainError> {
    check(runs)?;
    let of_run = |place: usize, cause: TrainError| match runs {
        [_] => cause,
        _ => {
            let run_folder = runs[place].run_folder.to_path_buf();
            TrainError::OneOfMany { run_folder, cause: Box::new(cause) }
        }
    };
    let finish = |trainers: Vec<Trainer<'_>>| {
        let numbered = trainers.into_iter().enumerate();
        numbered
            .map(|(place, trainer)| trainer.finish().map_err(|cause| of_run(place, cause)))
            .collect()
    };
    let shared = SharedWeights::default();
    let mut trainers = Vec::with_capacity(runs.len());
    for (place, run) in runs.iter().enumerate() {
        let LockstepRun { config, data, held_out, run_folder } = *run;
        let shared = shared.clone();
        let trainer = Trainer::start(config, data, held_out, run_folder, resume, shared);
        trainers.push(trainer.map_err(|cause| of_run(place, cause))?);
    }
    let end = rounds(&mut trainers, is_stopped, &mut on_progress);
    let failed = match &end {
        Ok(ControlFlow::Continue(())) => return finish(trainers),
        Ok(ControlFlow::Break(())) => None,
        Err((place, _)) => Some(*place),
    };
    for (place, trainer) in trainers.iter().enumerate() {
        // A run that failed keeps its last checkpoint.
        if trainer.has_next() && Some(place) != failed {
            trainer.write_checkpoint()?;
        }
    }
    match end {
        Err((place, cause)) => Err(of_run(place, cause)),
        Ok(_) => finish(trainers),
    }
}

/// The place of a run that failed, and why.
type Failure = (usize, TrainError);

/// Until all runs are finished, or one is stopped.
fn rounds(
    trainers: &mut [Trainer<'_>],
    is_stopped: &AtomicBool,
    on_progress: &mut impl FnMut(usize, &Progress) -> ControlFlow<()>,
) -> Result<ControlFlow<()>, Failure> {
    loop {
        let unfinished = trainers.iter().filter(|trainer| trainer.has_next());
        let Some(step) = unfinished.map(Trainer::step).min() else {
            return Ok(ControlFlow::Continue(()));
        };
        let at_step = |trainer: &Trainer<'_>| trainer.has_next() && trainer.step() == step;
        let ahead = trainers.iter().filter(|trainer| at_step(trainer)).find_map(Trainer::ahead);
        let round = std::thread::scope(|scope| -> Result<ControlFlow<()>, Failure> {
            if let Some(ahead) = ahead {
                scope.spawn(move || ahead.compute());
            }
            for (place, trainer) in trainers.iter_mut().enumerate() {
                if !at_step(trainer) {
                    continue;
                }
                let mut report = |progress: &Progress| on_progress(place, progress);
                let advanced = trainer.advance(is_stopped, &mut report);
                if advanced.map_err(|error| (place, error))?.is_break() {
                    return Ok(ControlFlow::Break(()));
                }
            }
            Ok(ControlFlow::Continue(()))
        })?;
        if round.is_break() {
            return Ok(round);
        }
    }
}

fn check(runs: &[LockstepRun<'_>]) -> Result<(), TrainError> {
    let Some(first) = runs.first() else { return Ok(()) };
    let wrong = |message: String| Err(TrainError::Setting { message });
    let mut folders = HashSet::new();
    for run in runs {
        let pairs = [
            ("batch_seed", run.config.batch_seed(), first.config.batch_seed()),
            ("batch", run.config.batch as u64, first.config.batch as u64),
            ("the number of rows", run.data.len() as u64, first.data.len() as u64),
        ];
        for (name, got, want) in pairs {
            if got != want {
                return wrong(format!(
                    "{name} is {got} in one run and {want} in another; runs in lockstep draw the \
                     same batches"
                ));
            }
        }
        if !folders.insert(run.run_folder) {
            return wrong(format!("{} is the folder of two runs", run.run_folder.display()));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
