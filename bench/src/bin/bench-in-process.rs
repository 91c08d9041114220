//! Our own environments without any server: what the protocol costs is what the others lack of this.

use std::time::Instant;

use clap::Parser;
use palr_gym_bench::{Measurement, Workload, report};
use palr_gym_sim::{SimulationThreads, StepFrame, VectorEnv, VectorOptions, resolve};

#[derive(Debug, Parser)]
#[command(about = "Measures our environments in process")]
struct Cli {
    #[command(flatten)]
    workload: Workload,
    /// Threads: as many as the server has.
    #[arg(long, default_value_t = std::thread::available_parallelism().map_or(1, usize::from))]
    threads: usize,
}

fn main() -> anyhow::Result<()> {
    palr_gym_sim::mujoco_log::route_to_log();
    let Cli { workload, threads } = Cli::parse();
    let (task, spec) = resolve(&workload.task)?;
    let row = workload.num_envs * spec.action_size();
    let actions = workload.actions(spec.action_size());
    let threads = SimulationThreads::start(threads)?;
    let mut vector =
        VectorEnv::new(task, spec, workload.num_envs, VectorOptions::default(), threads)?;
    vector.reset(&[workload.seed], &[])?;
    let mut frame = StepFrame::default();
    let mut play = |actions: &[f32]| -> anyhow::Result<u64> {
        let mut env_steps = 0;
        for actions in actions.chunks_exact(row) {
            // Those whose episode has ended are only reset by this step.
            let ended =
                frame.terminated.iter().zip(&frame.truncated).filter(|(a, b)| **a || **b).count();
            vector.step(actions, &mut frame)?;
            env_steps += (workload.num_envs - ended) as u64;
        }
        Ok(env_steps)
    };
    let (warm_up, measured) = actions.split_at(workload.warm_up * row);
    play(warm_up)?;
    let started = Instant::now();
    let env_steps = play(measured)?;
    let wall_s = started.elapsed().as_secs_f64();
    report(&Measurement { env_steps, wall_s, rate: env_steps as f64 / wall_s })?;
    Ok(())
}
