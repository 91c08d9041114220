//! The limit: how fast bare MuJoCo is at the work that a server of ours is given.
//!
//! The same environments go through the same states as behind the server: same seeds, same
//! float32 actions, resets at the same steps into the same start states. Per environment step
//! there is `frame_skip` × `mj_step` and nothing else; per reset `mj_resetData`, the start state
//! and `mj_forward`. No message, observation, reward, test for the end or random number: where
//! episodes end and start was recorded beforehand from our own simulation, and in the end every
//! state is compared with the recorded one, bit for bit.
//!
//! The schedule is the best that there is. A vector environment steps all environments before any
//! of them may go on, because the next actions depend on what came of the last. Here each thread
//! runs its share of the environments one after the other through all their steps, so nothing
//! waits and one environment at a time is in the cache; and a thread that ends early does not wait
//! for the others: the rates of the threads are added.

use std::ops::Range;
use std::sync::{Arc, Barrier};
use std::thread;
use std::time::Instant;

use anyhow::{Context, ensure};
use clap::{Parser, ValueEnum};
use mujoco_rs::prelude::{MjData, MjModel};
use palr_gym_bench::{Measurement, Workload, report};
use palr_gym_sim::{Env, SimulationThreads, StepFrame, Task, VectorEnv, VectorOptions, resolve};

#[derive(Debug, Parser)]
#[command(about = "Measures bare mj_step")]
struct Cli {
    #[command(flatten)]
    workload: Workload,
    /// Threads: as many as the server has.
    #[arg(long, default_value_t = thread::available_parallelism().map_or(1, usize::from))]
    threads: usize,
    /// What a thread does next. Only `env` is the limit; `step` shows what caches are worth.
    #[arg(long, value_enum, default_value_t = Order::Env)]
    order: Order,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Order {
    /// The next step of the same environment.
    Env,
    /// The same step of the next environment.
    Step,
}

/// Positions and velocities, which after a reset are all there is to a state.
#[derive(Debug, Clone, PartialEq)]
struct State {
    qpos: Vec<f64>,
    qvel: Vec<f64>,
}

impl State {
    fn of(env: &Env) -> Self {
        Self { qpos: env.state().qpos().to_vec(), qvel: env.state().qvel().to_vec() }
    }
}

/// What one environment did behind our simulation.
struct Recording {
    start: State,
    /// Steps that only reset, ascending, and where the new episodes started.
    resets: Vec<(usize, State)>,
    end: State,
}

/// Steps our simulation through the work and notes where episodes begin.
fn record(
    workload: &Workload,
    actions: &[f32],
    threads: usize,
) -> anyhow::Result<(&'static dyn Task, Vec<Recording>)> {
    let (task, spec) = resolve(&workload.task)?;
    let threads = SimulationThreads::start(threads)?;
    let options = VectorOptions::default();
    let mut vector = VectorEnv::new(task, spec, workload.num_envs, options, threads)?;
    vector.reset(&[workload.seed], &[])?;
    let states = |vector: &VectorEnv| {
        let mut states = Vec::with_capacity(workload.num_envs);
        vector.for_each_env(|_, env| states.push(State::of(env)));
        states
    };
    let starts = states(&vector);
    let mut resets = vec![Vec::new(); workload.num_envs];
    let mut frame = StepFrame::default();
    let mut is_over = vec![false; workload.num_envs];
    let row = actions.len() / workload.total_steps();
    for (step, actions) in actions.chunks_exact(row).enumerate() {
        vector.step(actions, &mut frame)?;
        vector.for_each_env(|index, env| {
            if is_over[index] {
                resets[index].push((step, State::of(env)));
            }
        });
        for (index, is_over) in is_over.iter_mut().enumerate() {
            *is_over = frame.terminated[index] || frame.truncated[index];
        }
    }
    let ends = states(&vector);
    let recordings = starts
        .into_iter()
        .zip(resets)
        .zip(ends)
        .map(|((start, resets), end)| Recording { start, resets, end })
        .collect();
    Ok((task, recordings))
}

/// One environment that does it again, without our simulation.
struct Replay<'a> {
    data: MjData<Arc<MjModel>>,
    frame_skip: u32,
    /// Its action of step t is `actions[t * stride..][..action_size]`.
    actions: &'a [f32],
    stride: usize,
    recording: &'a Recording,
    resets_done: usize,
}

impl Replay<'_> {
    fn put(&mut self, state: &State) {
        self.data.reset();
        self.data.qpos_mut().copy_from_slice(&state.qpos);
        self.data.qvel_mut().copy_from_slice(&state.qvel);
        self.data.forward();
    }

    /// Takes `steps` and returns how many of them did not only reset.
    fn run(&mut self, steps: Range<usize>) -> u64 {
        let mut env_steps = 0;
        for step in steps {
            let recording = self.recording;
            match recording.resets.get(self.resets_done) {
                Some((reset, state)) if *reset == step => {
                    self.put(state);
                    self.resets_done += 1;
                }
                _ => {
                    let action = &self.actions[step * self.stride..];
                    for (control, &entry) in self.data.ctrl_mut().iter_mut().zip(action) {
                        *control = f64::from(entry);
                    }
                    for _ in 0..self.frame_skip {
                        self.data.step();
                    }
                    env_steps += 1;
                }
            }
        }
        env_steps
    }

    fn is_where_it_was(&self) -> bool {
        let end = &self.recording.end;
        self.data.qpos() == end.qpos.as_slice() && self.data.qvel() == end.qvel.as_slice()
    }
}

fn run_all(replays: &mut [Replay<'_>], steps: Range<usize>, order: Order) -> u64 {
    match order {
        Order::Env => replays.iter_mut().map(|replay| replay.run(steps.clone())).sum(),
        Order::Step => steps
            .map(|step| replays.iter_mut().map(|replay| replay.run(step..step + 1)).sum::<u64>())
            .sum(),
    }
}

fn main() -> anyhow::Result<()> {
    palr_gym_sim::mujoco_log::route_to_log();
    let Cli { workload, threads, order } = Cli::parse();
    let action_size = resolve(&workload.task)?.1.action_size();
    let actions = workload.actions(action_size);
    let (task, recordings) = record(&workload, &actions, threads)?;
    let model = task.scene().model()?;
    let stride = workload.num_envs * action_size;
    let mut replays = recordings
        .iter()
        .enumerate()
        .map(|(index, recording)| {
            let mut replay = Replay {
                data: MjData::try_new(Arc::clone(&model))?,
                frame_skip: task.spec().frame_skip,
                actions: &actions[index * action_size..],
                stride,
                recording,
                resets_done: 0,
            };
            replay.put(&recording.start);
            Ok(replay)
        })
        .collect::<anyhow::Result<Vec<_>>>()
        .context("MuJoCo has no memory for the environments")?;

    let share = workload.num_envs.div_ceil(threads);
    let shares = replays.chunks_mut(share);
    let barrier = Barrier::new(shares.len());
    let measure = |replays: &mut [Replay<'_>]| {
        run_all(replays, 0..workload.warm_up, order);
        barrier.wait();
        let started = Instant::now();
        let env_steps = run_all(replays, workload.warm_up..workload.total_steps(), order);
        let wall_s = started.elapsed().as_secs_f64();
        Measurement { env_steps, wall_s, rate: env_steps as f64 / wall_s }
    };
    let total = thread::scope(|scope| {
        let threads: Vec<_> = shares.map(|replays| scope.spawn(|| measure(replays))).collect();
        threads.into_iter().try_fold(
            Measurement { env_steps: 0, wall_s: 0.0, rate: 0.0 },
            |total, thread| {
                let part = thread.join().ok()?;
                Some(Measurement {
                    env_steps: total.env_steps + part.env_steps,
                    wall_s: total.wall_s.max(part.wall_s),
                    rate: total.rate + part.rate,
                })
            },
        )
    })
    .context("a thread panicked")?;

    let strays = replays.iter().filter(|replay| !replay.is_where_it_was()).count();
    ensure!(strays == 0, "{strays} environments went elsewhere than behind our simulation");
    report(&total)?;
    Ok(())
}
