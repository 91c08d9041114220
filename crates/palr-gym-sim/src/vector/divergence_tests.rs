//! Simulations that go wrong, in scenes made for it: their episodes end, everything else goes on.

use palr_gym_core::random::Generator;
use palr_gym_core::task::ObservationEntry;
use palr_gym_core::{EnvId, Fidelity, Mask, ReferenceReturns, SceneOptions, TaskSpec};

use super::*;
use crate::divergence::Divergence;
use crate::physics::{Physics, Scene, Start};
use crate::tasks::Outcome;

/// Boxes that fall on a floor, in an arena with this much room.
macro_rules! boxes {
    ($name:literal, $memory:literal) => {
        Boxes {
            spec: TaskSpec { name: $name, ..SPEC },
            scene: Scene::new(
                $name,
                concat!(
                    "<mujoco><size memory='",
                    $memory,
                    "'/><worldbody><geom type='plane' size='1 1 1'/>",
                    "<body pos='0 0 .3'><freejoint/><geom type='box' size='.1 .1 .1'/></body>",
                    "<body pos='1 0 .3'><freejoint/><geom type='box' size='.1 .1 .1'/></body>",
                    "<body pos='2 0 .3'><freejoint/><geom type='box' size='.1 .1 .1'/></body>",
                    "<body pos='3 0 .3'><freejoint/><geom type='box' size='.1 .1 .1'/></body>",
                    "<body pos='-1 0 1'><joint name='slide' type='slide' axis='1 0 0'/>",
                    "<geom size='.1'/></body></worldbody>",
                    "<actuator><motor joint='slide'/></actuator></mujoco>"
                ),
            ),
        }
    };
}

const SPEC: TaskSpec = TaskSpec {
    name: "boxes",
    description: "Boxes fall on a floor.",
    fidelity: Fidelity::Gym4,
    equals: "nothing",
    observation: &[ObservationEntry::unbounded("qpos[slide]")],
    action_names: &["slide"],
    agent_camera: None,
    paper_mask: &[0],
    strict_mask: &[0],
    max_episode_steps: 1000,
    frame_skip: 5,
    physics_timestep_s: 0.002,
    info_names: &["height"],
    reset_info_names: &[],
    camera_names: &[],
    expert_observation_size: 1,
    reference_returns: ReferenceReturns { random: 0.0, expert: 1.0 },
};

/// The engine gives up when the boxes touch the floor.
static CRAMPED: Boxes = boxes!("cramped", "16000");
/// The engine drops constraints when they do.
static TIGHT: Boxes = boxes!("tight", "24000");
/// Nothing goes wrong by itself.
static ROOMY: Boxes = boxes!("roomy", "1M");

struct Boxes {
    spec: TaskSpec,
    scene: Scene,
}

/// With this seed and above, an episode begins with a speed no engine can bear.
const SEED_OF_SPEED: u64 = 100;

impl Task for Boxes {
    fn spec(&self) -> &'static TaskSpec {
        match self.spec.name {
            "cramped" => &CRAMPED.spec,
            "tight" => &TIGHT.spec,
            _ => &ROOMY.spec,
        }
    }

    fn scene(&self) -> &'static Scene {
        match self.spec.name {
            "cramped" => &CRAMPED.scene,
            "tight" => &TIGHT.scene,
            _ => &ROOMY.scene,
        }
    }

    fn perturb(&self, generator: &mut Generator, _: &SceneOptions, start: &mut Start) {
        if *generator == Generator::from_seed(SEED_OF_SPEED) {
            start.qvel[0] = 1e11;
        }
    }

    fn observe(&self, physics: &Physics, observation: &mut [f64]) {
        observation[0] = physics.qpos()[28];
    }

    fn position_m(&self, _: &Physics) -> [f64; 2] {
        [0.0; 2]
    }

    fn outcome(&self, physics: &Physics, _: [f64; 2], _: &[f32], info: &mut [f64]) -> Outcome {
        info[0] = physics.qpos()[2];
        Outcome { reward: 1.0, terminated: false }
    }
}

fn vector(task: &'static Boxes, num_envs: usize, mode: AutoresetMode) -> VectorEnv {
    on_threads(2, task, num_envs, mode)
}

fn on_threads(
    threads: usize,
    task: &'static Boxes,
    num_envs: usize,
    mode: AutoresetMode,
) -> VectorEnv {
    let env_id = EnvId {
        task: task.spec.name.into(),
        mask: Mask::Full,
        fidelity: Fidelity::Gym4,
        frame_stack: 2,
    };
    let spec = EnvSpec::new(env_id, &task.spec);
    let threads = SimulationThreads::start(threads).unwrap();
    let options = VectorOptions { autoreset_mode: mode, out_of_bounds: OutOfBounds::Raw };
    VectorEnv::new(task, spec, num_envs, options, threads).unwrap()
}

#[test]
fn an_error_of_the_engine_or_a_warning_ends_the_episode_and_a_reset_makes_it_good() {
    for (task, expected) in
        [(&CRAMPED, Divergence::EngineError), (&TIGHT, Divergence::ConstraintsFull)]
    {
        let mut vector = vector(task, 3, AutoresetMode::NextStep);
        vector.reset(&[0], &[]).unwrap();
        let (mut frame, mut before) = (StepFrame::default(), StepFrame::default());
        for _episode in 0..3 {
            let mut steps = 0;
            loop {
                std::mem::swap(&mut frame, &mut before);
                vector.step(&[0.5; 3], &mut frame).unwrap();
                if !frame.diverged.is_empty() {
                    break;
                }
                steps += 1;
                assert!(steps < 60, "nothing went wrong");
            }
            assert!(steps > 5, "it went wrong at once");
            // All three are alike, so they fail in the same step.
            let reasons: Vec<_> =
                frame.diverged.iter().map(|diverged| diverged.divergence).collect();
            assert_eq!(reasons, [expected; 3]);
            assert_eq!(frame.truncated, [true; 3]);
            assert_eq!(frame.terminated, [false; 3]);
            assert_eq!(frame.rewards, [0.0; 3]);
            assert_eq!(frame.observations, before.observations);
            assert!(frame.info.iter().all(|value| value.is_nan()));
            vector.step(&[0.5; 3], &mut frame).unwrap();
            assert_eq!((frame.observations[1], frame.truncated[0]), (0.0, false));
        }
    }
}

#[test]
fn a_huge_control_ends_only_the_episode_that_it_drives() {
    let mut vector = vector(&ROOMY, 3, AutoresetMode::SameStep);
    vector.reset(&[0], &[]).unwrap();
    let mut frame = StepFrame::default();
    for huge in [1e12, f32::INFINITY] {
        vector.step(&[0.5, 0.25, 0.5], &mut frame).unwrap();
        let before = frame.observations.clone();
        vector.step(&[0.5, huge, 0.5], &mut frame).unwrap();
        let expected =
            DivergedEpisode { step: 0, env_index: 1, divergence: Divergence::BadControl };
        assert_eq!(frame.diverged, [expected]);
        assert_eq!(frame.truncated, [false, true, false]);
        assert_eq!(frame.rewards, [1.0, 0.0, 1.0]);
        // The last good observation, and the new episode's first one beside it.
        assert_eq!(frame.final_observations[2..4], before[2..4]);
        assert_eq!(frame.observations[2..4], [0.0, 0.0]);
        vector.step(&[0.5; 3], &mut frame).unwrap();
        assert_eq!(frame.diverged, []);
    }
}

#[test]
fn a_state_that_no_engine_bears_ends_the_episode() {
    let mut vector = vector(&ROOMY, 2, AutoresetMode::Disabled);
    vector.reset(&[SEED_OF_SPEED], &[]).unwrap();
    let mut frame = StepFrame::default();
    // Of five steps asked for, the first is the last one.
    vector.step_open_loop(&[0.0; 10], 5, &mut frame).unwrap();
    let expected = DivergedEpisode { step: 0, env_index: 0, divergence: Divergence::BadVelocity };
    assert_eq!((frame.steps, frame.diverged.as_slice()), (1, &[expected][..]));
    assert_eq!(vector.step(&[0.0; 2], &mut frame), Err(SimError::ResetNeeded { env_index: 0 }));
    vector.reset(&[0], &[0]).unwrap();
    vector.step_open_loop(&[0.0; 10], 5, &mut frame).unwrap();
    assert_eq!((frame.steps, frame.diverged.len()), (5, 0));
}

#[test]
fn what_went_wrong_on_a_workbench_is_not_felt_by_the_next_environment() {
    let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
    let mut alone = vector(&ROOMY, 1, AutoresetMode::NextStep);
    // One thread, so that both are worked on at the same bench.
    let mut beside = on_threads(1, &ROOMY, 2, AutoresetMode::NextStep);
    alone.reset(&[7], &[]).unwrap();
    let (mut expected, mut frame) = (StepFrame::default(), StepFrame::default());
    // The first one, again and again, begins with a speed no engine can bear.
    beside.reset(&[SEED_OF_SPEED, 7], &[]).unwrap();
    let mut went_wrong = 0;
    for _ in 0..40 {
        alone.step(&[0.5], &mut expected).unwrap();
        beside.step(&[0.5, 0.5], &mut frame).unwrap();
        went_wrong += frame.diverged.len();
        assert!(frame.diverged.iter().all(|diverged| diverged.env_index == 0));
        let size = expected.observations.len();
        assert_eq!(bits(&frame.observations[size..]), bits(&expected.observations));
        if frame.truncated[0] {
            beside.reset(&[SEED_OF_SPEED, 7], &[0]).unwrap();
        }
    }
    assert!(went_wrong > 20, "only {went_wrong} went wrong");
}
