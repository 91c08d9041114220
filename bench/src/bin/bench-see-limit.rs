//! The limit of seeing: bare MuJoCo, drawing, and features in ONNX Runtime, without any of our
//! environments.
//!
//! `render` draws one pose again and again. `step` takes the environments of a session of
//! `lane-w3` through the same states as behind our server: start states and the car ahead were recorded
//! beforehand from our own simulation, and in the end every position and velocity is compared with
//! the recorded one, bit for bit. Each thread has its share of the environments, draws them after
//! each step, and makes their features in batches of 32; no thread waits for another, and nobody is
//! told anything.

use std::sync::{Arc, Barrier};
use std::thread;
use std::time::Instant;

use anyhow::{Context, ensure};
use clap::{Parser, Subcommand};
use mujoco_rs::prelude::{MjData, MjModel, MjtObjBase};
use palr_gym_bench::bare::Painter;
use palr_gym_bench::{Measurement, Seen, Workload, cpu_s, report};
use palr_gym_onnx::{Limits, Model};
use palr_gym_sim::physics::KEPT_STATE;
use palr_gym_sim::render::{GlChoice, View, prepare_process};
use palr_gym_sim::{Env, SimulationThreads, StepFrame, Task, VectorEnv, VectorOptions, resolve};
use palr_gym_vision::{ExtractorLimits, Preprocessing};

const TASK: &str = "lane";
const SIDE_PX: usize = 48;
const BATCH: usize = 32;
const EXTRACTOR: &[u8] = include_bytes!("../../../scenes/features/lane-compact-resnet.onnx");

#[derive(Debug, Parser)]
#[command(about = "Measures bare drawing, and bare stepping with drawing and features")]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Draws lane's driver picture, 48 x 48 pixels, on one thread.
    Render {
        /// Pictures.
        #[arg(long)]
        pictures: usize,
    },
    /// Steps lane and sees it.
    Step {
        #[command(flatten)]
        workload: Workload,
        /// Threads: as many as the server has.
        #[arg(long, default_value_t = thread::available_parallelism().map_or(1, usize::from))]
        threads: usize,
    },
}

fn main() -> anyhow::Result<()> {
    // Else Mesa starts threads of its own.
    prepare_process();
    palr_gym_sim::mujoco_log::route_to_log();
    match Cli::parse().command {
        Command::Render { pictures } => report(&render(pictures)?)?,
        Command::Step { workload, threads } => report(&step(&workload, threads)?)?,
    }
    Ok(())
}

fn painter(model: &MjModel) -> anyhow::Result<Painter> {
    let camera = model.name_to_id(MjtObjBase::mjOBJ_CAMERA, "driver");
    Painter::new(model, camera.context("the scene has no driver's camera")?, SIDE_PX)
}

fn render(pictures: usize) -> anyhow::Result<Seen> {
    let (task, spec) = resolve(TASK)?;
    let mut env = Env::new(task, &Arc::new(spec))?;
    env.reset(Some(0))?;
    let model = task.scene().model()?;
    let mut data = MjData::try_new(Arc::clone(&model))?;
    data.set_state(env.state().values(), KEPT_STATE)?;
    let (mut picture, mut ours) = (Vec::new(), Vec::new());
    // A thread has one context at a time: ours is made, used and left on another one.
    let side = SIDE_PX as u32;
    let view = View { camera: Some("driver"), width_px: side, height_px: side };
    thread::scope(|scope| {
        let drawn = scope.spawn(|| env.draw(GlChoice::Osmesa, view, &mut ours)).join();
        drawn.ok().context("a thread panicked")?.map_err(anyhow::Error::from)
    })?;
    let mut painter = painter(&model)?;
    // The first pictures compile shaders.
    for _ in 0..20 {
        picture.clear();
        painter.paint(&mut data, &mut picture)?;
    }
    ensure!(picture == ours, "the bare picture is not the one that our renderer draws");
    let (started, before) = (Instant::now(), cpu_s()?);
    for _ in 0..pictures {
        picture.clear();
        painter.paint(&mut data, &mut picture)?;
    }
    Ok(Seen::new(pictures, started.elapsed(), cpu_s()? - before))
}

/// Where the car ahead is: position and quaternion.
type Lead = ([f64; 3], [f64; 4]);

/// What one environment did behind our simulation.
#[derive(Default)]
struct Recording {
    /// Steps that only reset, ascending, with the whole state after each; the start is "step 0".
    starts: Vec<(usize, Vec<f64>)>,
    /// After each step.
    leads: Vec<Lead>,
    /// Positions and velocities.
    end: (Vec<f64>, Vec<f64>),
}

/// Steps our simulation, which sees nothing, through the work.
fn record(workload: &Workload, actions: &[f32], threads: usize) -> anyhow::Result<Vec<Recording>> {
    let (task, spec) = resolve(TASK)?;
    let threads = SimulationThreads::start(threads)?;
    let num_envs = workload.num_envs;
    let mut vector = VectorEnv::new(task, spec, num_envs, VectorOptions::default(), threads)?;
    vector.reset(&[workload.seed], &[])?;
    let mut recordings: Vec<Recording> =
        std::iter::repeat_with(Recording::default).take(num_envs).collect();
    vector.for_each_env(|index, env| {
        recordings[index].starts.push((0, env.state().values().to_vec()));
    });
    let mut scratch = MjData::try_new(task.scene().model()?)?;
    let mut frame = StepFrame::default();
    let mut is_over = vec![false; num_envs];
    let row = actions.len() / workload.total_steps();
    for (step, actions) in actions.chunks_exact(row).enumerate() {
        vector.step(actions, &mut frame)?;
        let mut failure = None;
        vector.for_each_env(|index, env| {
            let values = env.state().values();
            failure = failure.take().or(scratch.set_state(values, KEPT_STATE).err());
            recordings[index].leads.push((scratch.mocap_pos()[0], scratch.mocap_quat()[0]));
            if is_over[index] {
                recordings[index].starts.push((step, values.to_vec()));
            }
        });
        failure.map_or(Ok(()), Err)?;
        for (index, is_over) in is_over.iter_mut().enumerate() {
            *is_over = frame.terminated[index] || frame.truncated[index];
        }
    }
    vector.for_each_env(|index, env| {
        let state = env.state();
        recordings[index].end = (state.qpos().to_vec(), state.qvel().to_vec());
    });
    Ok(recordings)
}

/// One environment that does it again.
struct Replay<'a> {
    data: MjData<Arc<MjModel>>,
    task: &'static dyn Task,
    /// Its action of step t is `actions[t * stride..][..action_size]`.
    actions: &'a [f32],
    stride: usize,
    recording: &'a Recording,
    next_start: usize,
}

impl Replay<'_> {
    /// Takes step `step`, or the reset that stands for it; then `false`.
    fn step(&mut self, step: usize) -> anyhow::Result<bool> {
        if let Some((at, values)) = self.recording.starts.get(self.next_start)
            && *at == step
        {
            self.data.set_state(values, KEPT_STATE)?;
            self.next_start += 1;
            return Ok(false);
        }
        let spec = self.task.spec();
        let action = &self.actions[step * self.stride..][..spec.action_names.len()];
        self.task.controls(action, self.data.ctrl_mut());
        for _ in 0..spec.frame_skip {
            self.data.step();
        }
        let (position, quaternion) = self.recording.leads[step];
        self.data.mocap_pos_mut()[0] = position;
        self.data.mocap_quat_mut()[0] = quaternion;
        Ok(true)
    }

    fn is_where_it_was(&self) -> bool {
        let (qpos, qvel) = &self.recording.end;
        self.data.qpos() == qpos.as_slice() && self.data.qvel() == qvel.as_slice()
    }
}

/// What a thread sees with.
struct Eyes {
    painter: Painter,
    model: Model,
    preprocessing: Preprocessing,
    output: String,
    size: usize,
    pictures: Vec<u8>,
    input: Vec<f32>,
}

impl Eyes {
    fn new(model: &MjModel) -> anyhow::Result<Self> {
        let ExtractorLimits { max_bytes, max_inference } = ExtractorLimits::default();
        let mut extractor = Model::open(EXTRACTOR, Limits { max_bytes, max_inference })?;
        let preprocessing = Preprocessing::read(extractor.metadata())?;
        let output = extractor.output_names().first().context("no output")?.clone();
        let blank = vec![0.0; 3 * preprocessing.area()];
        let size = extractor
            .run(&[1, 3, SIDE_PX, SIDE_PX], &blank, |outputs| Ok(outputs.columns(&output)))?;
        Ok(Self {
            painter: painter(model)?,
            model: extractor,
            preprocessing,
            output,
            size: size.context("no features")?,
            pictures: Vec::new(),
            input: Vec::new(),
        })
    }

    fn see(&mut self, replays: &mut [Replay<'_>]) -> anyhow::Result<()> {
        let count = replays.len();
        self.pictures.clear();
        for replay in replays {
            self.painter.paint(&mut replay.data, &mut self.pictures)?;
        }
        self.preprocessing.apply(&self.pictures, &mut self.input);
        let shape = [count, 3, SIDE_PX, SIDE_PX];
        let features = self
            .model
            .run(&shape, &self.input, |outputs| outputs.matrix(&self.output, count, self.size))?;
        std::hint::black_box(features);
        Ok(())
    }
}

fn step(workload: &Workload, threads: usize) -> anyhow::Result<Measurement> {
    let (task, spec) = resolve(TASK)?;
    ensure!(
        resolve(&workload.task)?.1.task.name == TASK,
        "only {TASK} and what is shown of it are stepped; not {}",
        workload.task
    );
    let action_size = spec.action_size();
    let actions = workload.actions(action_size);
    let recordings = record(workload, &actions, threads)?;
    let model = task.scene().model()?;
    let stride = workload.num_envs * action_size;
    let mut replays = recordings
        .iter()
        .enumerate()
        .map(|(index, recording)| {
            let mut data = MjData::try_new(Arc::clone(&model))?;
            data.set_state(&recording.starts[0].1, KEPT_STATE)?;
            let actions = &actions[index * action_size..];
            Ok(Replay { data, task, actions, stride, recording, next_start: 1 })
        })
        .collect::<anyhow::Result<Vec<_>>>()?;
    let shares = replays.chunks_mut(workload.num_envs.div_ceil(threads));
    let barrier = Barrier::new(shares.len());
    let measure = |replays: &mut [Replay<'_>]| -> anyhow::Result<Measurement> {
        let eyes = Eyes::new(&model);
        let mut play = |eyes: &mut Eyes, from: usize, to: usize| -> anyhow::Result<u64> {
            let mut env_steps = 0;
            for step in from..to {
                for batch in replays.chunks_mut(BATCH) {
                    for replay in &mut *batch {
                        env_steps += u64::from(replay.step(step)?);
                    }
                    eyes.see(batch)?;
                }
            }
            Ok(env_steps)
        };
        let warm = eyes.and_then(|mut eyes| {
            play(&mut eyes, 0, workload.warm_up)?;
            Ok(eyes)
        });
        // Whoever failed must not keep the others waiting.
        barrier.wait();
        let mut eyes = warm?;
        let started = Instant::now();
        let env_steps = play(&mut eyes, workload.warm_up, workload.total_steps())?;
        let wall_s = started.elapsed().as_secs_f64();
        Ok(Measurement { env_steps, wall_s, rate: env_steps as f64 / wall_s })
    };
    let total = thread::scope(|scope| {
        let threads: Vec<_> = shares.map(|replays| scope.spawn(|| measure(replays))).collect();
        let mut total = Measurement { env_steps: 0, wall_s: 0.0, rate: 0.0 };
        for thread in threads {
            let part = thread.join().ok().context("a thread panicked")??;
            total.env_steps += part.env_steps;
            total.wall_s = total.wall_s.max(part.wall_s);
            total.rate += part.rate;
        }
        anyhow::Ok(total)
    })?;
    let strays = replays.iter().filter(|replay| !replay.is_where_it_was()).count();
    ensure!(strays == 0, "{strays} environments went elsewhere than behind our simulation");
    Ok(total)
}
