//! Milliseconds a training step at the sizes of hopper-w2, on one thread:
//! `cargo run --release -p palr-gym-trainer --example step_time`.

#![allow(clippy::print_stdout, reason = "the figures are what it is run for")]

use std::error::Error;
use std::time::Instant;

use palr_gym_core::random::Generator;
use palr_gym_trainer::learning::algorithms::method;
use palr_gym_trainer::learning::context::Context;
use palr_gym_trainer::learning::kernel::hscic_gradient;
use palr_gym_trainer::learning::regularizer::SharedWeights;
use palr_gym_trainer::learning::weights::{KernelConfig, WeightMatrix};
use palr_gym_trainer::learning::{
    Algorithm, PalrConfig, TrainConfig, TrainError, TrainingSet, WeightsMode,
};

const OBSERVATION_SIZE: usize = 10;
const ACTION_SIZE: usize = 3;
const BATCH: usize = 1024;
const ROWS: usize = 30_000;

fn main() -> Result<(), Box<dyn Error>> {
    let data = data()?;
    let cases = [
        (Algorithm::Bc, WeightsMode::Exact, 300),
        (Algorithm::Kf, WeightsMode::Exact, 200),
        (Algorithm::Primenet, WeightsMode::Exact, 200),
        (Algorithm::Rap, WeightsMode::Exact, 200),
        (Algorithm::Fca, WeightsMode::Exact, 60),
        (Algorithm::Mine, WeightsMode::Exact, 60),
        (Algorithm::Vib, WeightsMode::Exact, 200),
        (Algorithm::Palr, WeightsMode::Pool, 150),
        (Algorithm::Palr, WeightsMode::Exact, 15),
        (Algorithm::PalrAct, WeightsMode::Pool, 150),
    ];
    for (algorithm, weights, steps) in cases {
        let pool_size = 4;
        let palr = PalrConfig { weights, pool_size, ..PalrConfig::default() };
        let config = TrainConfig { algorithm, palr, ..TrainConfig::default() };
        let mut method = method(Context::new(&config, &data, SharedWeights::default()));
        let mut state = method.start();
        let mut step = || {
            method.step(&mut state)?;
            state.step += 1;
            Ok(())
        };
        // The first steps fill the pool.
        (0..pool_size).try_for_each(|_| step())?;
        report(&format!("{} ({weights:?})", algorithm.name()), steps, step)?;
    }

    let rows: Vec<usize> = (0..BATCH).collect();
    let (past, given) = data.hscic_actions(&rows, true);
    let config = KernelConfig { ridge: 1e-5, bandwidth_sq: 1.0 };
    let weights = WeightMatrix::new(&past, &given, ACTION_SIZE, config)?;
    report("M", 10, || WeightMatrix::new(&past, &given, ACTION_SIZE, config).map(drop))?;
    let mut generator = Generator::from_seed(1);
    let phi: Vec<f32> = (0..BATCH * 64).map(|_| 0.1 * generator.standard_normal() as f32).collect();
    report("HSCIC and gradient, M given", 100, || {
        std::hint::black_box(hscic_gradient(&phi, 64, &weights, 1.0));
        Ok(())
    })?;
    report("packing M", 30, || {
        std::hint::black_box(weights.pack());
        Ok(())
    })?;
    let packed = weights.pack();
    report("unpacking M", 30, || {
        std::hint::black_box(packed.unpack());
        Ok(())
    })?;
    Ok(())
}

fn report(
    name: &str,
    count: usize,
    mut work: impl FnMut() -> Result<(), TrainError>,
) -> Result<(), TrainError> {
    let mut times_ms = Vec::with_capacity(count);
    for _ in 0..count {
        let start = Instant::now();
        work()?;
        times_ms.push(start.elapsed().as_secs_f64() * 1e3);
    }
    times_ms.sort_by(f64::total_cmp);
    println!("{name}: median {:.2} ms, minimum {:.2} ms", times_ms[count / 2], times_ms[0]);
    Ok(())
}

/// An expert whose actions follow its past ones.
fn data() -> Result<TrainingSet, TrainError> {
    let mut generator = Generator::from_seed(0);
    let mut past = [0.0_f32; ACTION_SIZE];
    let (mut observations, mut actions, mut past_actions) = (vec![], vec![], vec![]);
    for _ in 0..ROWS {
        observations.extend((0..OBSERVATION_SIZE).map(|_| generator.standard_normal() as f32));
        past_actions.extend(past);
        past = past.map(|past| (0.7 * past + 0.5 * generator.standard_normal() as f32).tanh());
        actions.extend(past);
    }
    TrainingSet::new(&observations, OBSERVATION_SIZE, actions, past_actions, ACTION_SIZE)?
        .with_frame_stack(2)
}
