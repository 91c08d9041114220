//! The limit of recording: how fast bare MuJoCo and the expert's network are together.
//!
//! Each thread has environments of its own and goes through them in lockstep: one run of the
//! network for all of them, a sample of each action, then `frame_skip` × `mj_step` each. It looks
//! at a state only to make the observation and to see whether the hopper fell; nothing is
//! rewarded, kept, compressed or written, and no thread waits for another.

use std::sync::{Arc, Barrier};
use std::thread;
use std::time::Instant;

use anyhow::Context;
use clap::Parser;
use mujoco_rs::prelude::{MjData, MjModel};
use palr_gym_bench::{Measurement, report};
use palr_gym_core::random::Generator;
use palr_gym_core::tanh_gaussian;
use palr_gym_onnx::{Policy, PolicyLimits};
use palr_gym_sim::{Env, resolve};

const TASK: &str = "hopper";
const EXPERT: &[u8] = include_bytes!("../../../scenes/experts/hopper.onnx");
const MAX_STEPS: u32 = 1000;

#[derive(Debug, Parser)]
#[command(about = "Measures bare mj_step and inference")]
struct Cli {
    /// Transitions of all threads together.
    #[arg(long)]
    transitions: u64,
    /// Threads: as many as the server has.
    #[arg(long, default_value_t = thread::available_parallelism().map_or(1, usize::from))]
    threads: usize,
    /// Environments of each thread.
    #[arg(long, default_value_t = 16)]
    num_envs: usize,
}

struct Playing {
    data: MjData<Arc<MjModel>>,
    generator: Generator,
    steps: u32,
}

/// Where episodes start: drawn beforehand, as our environment draws them.
type Start = (Vec<f64>, Vec<f64>);

impl Playing {
    fn start(&mut self, (qpos, qvel): &Start) {
        self.data.reset();
        self.data.qpos_mut().copy_from_slice(qpos);
        self.data.qvel_mut().copy_from_slice(qvel);
        self.data.forward();
        self.steps = 0;
    }

    fn observe(&self, row: &mut [f32]) {
        let positions = self.data.qpos().iter().skip(1).copied();
        let velocities = self.data.qvel().iter().map(|velocity| velocity.clamp(-10.0, 10.0));
        for (entry, value) in row.iter_mut().zip(positions.chain(velocities)) {
            *entry = value as f32;
        }
    }

    fn is_over(&self) -> bool {
        let qpos = self.data.qpos();
        let is_healthy = qpos[1] > 0.7 && qpos[2].abs() < 0.2;
        !is_healthy || self.steps >= MAX_STEPS
    }
}

/// Plays `rounds` steps of all environments.
fn play(
    playing: &mut [Playing],
    policy: &mut Policy,
    starts: &[Start],
    sizes: (usize, usize, u32),
    rounds: u64,
) -> anyhow::Result<()> {
    let (observation_size, action_size, frame_skip) = sizes;
    let mut observations = vec![0.0; playing.len() * observation_size];
    let mut action = vec![0.0; action_size];
    let mut episodes = 0;
    for _ in 0..rounds {
        for (one, row) in playing.iter().zip(observations.chunks_exact_mut(observation_size)) {
            one.observe(row);
        }
        let output = policy.act(&observations, playing.len())?;
        let mean = output.mean.context("the expert has no mean")?;
        let log_std = output.log_std.context("the expert has no deviation")?;
        let heads = mean.chunks_exact(action_size).zip(log_std.chunks_exact(action_size));
        for (one, (mean, log_std)) in playing.iter_mut().zip(heads) {
            tanh_gaussian::sample(&mut one.generator, mean, log_std, &mut action);
            for (control, &entry) in one.data.ctrl_mut().iter_mut().zip(&action) {
                *control = f64::from(entry);
            }
            for _ in 0..frame_skip {
                one.data.step();
            }
            one.steps += 1;
            if one.is_over() {
                episodes += 1;
                one.start(&starts[episodes % starts.len()]);
            }
        }
    }
    Ok(())
}

fn main() -> anyhow::Result<()> {
    palr_gym_sim::mujoco_log::route_to_log();
    let Cli { transitions, threads, num_envs } = Cli::parse();
    let (task, spec) = resolve(TASK)?;
    let model = task.scene().model()?;
    let (observation_size, action_size) = (spec.observation_size(), spec.action_size());
    let sizes = (observation_size, action_size, task.spec().frame_skip);
    let mut env = Env::new(task, &Arc::new(spec))?;
    let starts = (0..64)
        .map(|seed| {
            env.reset(Some(seed))?;
            Ok((env.state().qpos().to_vec(), env.state().qvel().to_vec()))
        })
        .collect::<anyhow::Result<Vec<Start>>>()?;
    let rounds = transitions.div_ceil((threads * num_envs) as u64);
    let barrier = Barrier::new(threads);
    let measure = |thread: usize| -> anyhow::Result<Measurement> {
        let limits = PolicyLimits::default();
        let mut policy = Policy::load(EXPERT, observation_size, action_size, limits)?;
        let mut playing = (0..num_envs)
            .map(|index| {
                let generator = Generator::from_seed((thread * num_envs + index) as u64);
                let data = MjData::try_new(Arc::clone(&model))?;
                let mut one = Playing { data, generator, steps: 0 };
                one.start(&starts[index % starts.len()]);
                Ok(one)
            })
            .collect::<anyhow::Result<Vec<_>>>()?;
        play(&mut playing, &mut policy, &starts, sizes, rounds / 10)?;
        barrier.wait();
        let started = Instant::now();
        play(&mut playing, &mut policy, &starts, sizes, rounds)?;
        let wall_s = started.elapsed().as_secs_f64();
        let env_steps = rounds * num_envs as u64;
        Ok(Measurement { env_steps, wall_s, rate: env_steps as f64 / wall_s })
    };
    let measured = thread::scope(|scope| {
        let measure = &measure;
        let threads: Vec<_> =
            (0..threads).map(|thread| scope.spawn(move || measure(thread))).collect();
        threads
            .into_iter()
            .map(|thread| thread.join().ok().context("a thread panicked")?)
            .collect::<anyhow::Result<Vec<_>>>()
    })?;
    let total = measured.iter().fold(
        Measurement { env_steps: 0, wall_s: 0.0, rate: 0.0 },
        |total, part| Measurement {
            env_steps: total.env_steps + part.env_steps,
            wall_s: total.wall_s.max(part.wall_s),
            rate: total.rate + part.rate,
        },
    );
    report(&total)?;
    Ok(())
}
