//! Toy: the smallest task in which a policy that copies its past action is wrong, so that leakage
//! and its cure can be seen in seconds.
//!
//! A goal g, -1 or 1, changes sides with probability [`CHANGE`] before each step. The agent is paid
//! action · g. It never sees g but a cue, which equals g with probability [`RIGHT`] and is drawn anew
//! each step, and the cart's position, which is the past action: within a step the cart is there. The
//! demonstrator sees g and drives to its side at once.
//!
//! # Why the copycat is wrong
//! In the demonstrations the past action shows g of the step before, and tells more of g (98 of 100)
//! than the cue does (90 of 100): where they disagree, g is with the past action in 84 of 100. The
//! likeliest policy stays where it is, whatever the cue says, and once its past actions are its own
//! it stays there for good and earns nothing. What is independent of the past action given the
//! demonstrator's is the cue; the policy that follows it earns 2 · 0.9 - 1 = 0.8 a step.
//!
//! It matters that the cart arrives. One that goes part of the way sums up what its driver did, and
//! the policy of a copycat who leans to the cue a little sums up the cues: a fair filter of the goal.
//!
//! # The optimum
//! No policy that sees cues only, whatever it remembers, earns more than Bayes' rule does: the
//! expectation of |P(g = 1 | cues) - P(g = -1 | cues)|, summed over an episode. That is
//! [`OPTIMAL_RETURN`], and score 100; score 0 is that of actions that know nothing. The demonstrator,
//! who sees g, scores more than 100.

use palr_gym_core::random::Generator;
use palr_gym_core::task::ObservationEntry as Entry;
use palr_gym_core::{Fidelity, ReferenceReturns, SceneOptions, TaskSpec};

use super::{Outcome, Task};
use crate::physics::{Physics, Scene, Start};

/// Probability that the goal changes sides before a step.
const CHANGE: f64 = 0.02;
/// Probability that a cue shows the goal's side.
const RIGHT: f64 = 0.9;
const STEPS: u32 = 400;
/// Return of the best policy of the cues so far; computed anew by a test.
const OPTIMAL_RETURN: f64 = 370.21;

/// Places in the scene's userdata.
const GOAL: usize = 0;
const CUE: usize = 1;

const SPEC: TaskSpec = TaskSpec {
    name: "toy",
    description: "A cart drives to the side of a hidden goal, of which it sees a noisy cue.",
    fidelity: Fidelity::Gym4,
    equals: "nothing public (our own)",
    observation: &[
        Entry::unbounded("qpos[cart]"),
        Entry::clipped("cue", 1.0),
        Entry::unbounded("qvel[cart]"),
        Entry::clipped("goal", 1.0),
    ],
    action_names: &["cart"],
    agent_camera: None,
    paper_mask: &[0, 1],
    strict_mask: &[0, 1],
    max_episode_steps: STEPS,
    frame_skip: 10,
    physics_timestep_s: 0.005,
    info_names: &["goal"],
    reset_info_names: &[],
    expert_observation_size: 4,
    camera_names: &["track"],
    reference_returns: ReferenceReturns { random: 0.0, expert: OPTIMAL_RETURN },
};

static SCENE: Scene = Scene::new(SPEC.name, include_str!("../../../../scenes/toy.xml"));

/// The task.
pub(super) struct Toy;

impl Task for Toy {
    fn spec(&self) -> &'static TaskSpec {
        &SPEC
    }

    fn scene(&self) -> &'static Scene {
        &SCENE
    }

    fn perturb(&self, generator: &mut Generator, _: &SceneOptions, start: &mut Start) {
        start.userdata[GOAL] = 1.0;
        draw(generator, 0.5, &mut start.userdata);
    }

    fn draw_next(&self, generator: &mut Generator, userdata: &mut [f64]) {
        draw(generator, CHANGE, userdata);
    }

    fn observe(&self, physics: &Physics, observation: &mut [f64]) {
        let userdata = physics.userdata();
        observation.copy_from_slice(&[
            physics.qpos()[0],
            userdata[CUE],
            physics.qvel()[0],
            userdata[GOAL],
        ]);
    }

    fn position_m(&self, physics: &Physics) -> [f64; 2] {
        [physics.qpos()[0], 0.0]
    }

    fn outcome(
        &self,
        physics: &Physics,
        _before_m: [f64; 2],
        action: &[f32],
        info: &mut [f64],
    ) -> Outcome {
        let goal = physics.userdata()[GOAL];
        info.copy_from_slice(&[goal]);
        let action: f64 = action.iter().copied().map(f64::from).sum();
        Outcome { reward: action.clamp(-1.0, 1.0) * goal, terminated: false }
    }
}

/// The goal changes sides with this probability, then a cue is drawn.
fn draw(generator: &mut Generator, change: f64, userdata: &mut [f64]) {
    let goal = userdata[GOAL];
    userdata[GOAL] = if generator.next_f64() < change { -goal } else { goal };
    let is_right = generator.next_f64() < RIGHT;
    userdata[CUE] = if is_right { userdata[GOAL] } else { -userdata[GOAL] };
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::env::Env;
    use crate::tasks::resolve;

    /// Expectation of |P(g = 1 | cues) - P(g = -1 | cues)| after 1, 2, ... cues, over all cues.
    fn optimal_rewards(count: usize) -> Vec<f64> {
        // Of each sequence of cues: P(cues, g = 1) and P(cues, g = -1).
        let mut joint = vec![(0.5, 0.5)];
        (0..count)
            .map(|at| {
                let keep = if at == 0 { 1.0 } else { 1.0 - CHANGE };
                joint = joint
                    .iter()
                    .flat_map(|&(plus, minus)| {
                        let before = (
                            keep * plus + (1.0 - keep) * minus,
                            keep * minus + (1.0 - keep) * plus,
                        );
                        [RIGHT, 1.0 - RIGHT]
                            .map(|shown| (before.0 * shown, before.1 * (1.0 - shown)))
                    })
                    .collect();
                joint.iter().map(|(plus, minus): &(f64, f64)| (plus - minus).abs()).sum()
            })
            .collect()
    }

    #[test]
    fn score_100_is_what_bayes_rule_earns() {
        const ENUMERATED: usize = 16;
        let rewards = optimal_rewards(ENUMERATED);
        assert!((rewards[0] - (2.0 * RIGHT - 1.0)).abs() < 1e-12);
        let steady = rewards[ENUMERATED - 1];
        assert!(steady - rewards[ENUMERATED - 2] < 1e-4, "{rewards:?}");
        let total = rewards.iter().sum::<f64>() + (f64::from(STEPS) - ENUMERATED as f64) * steady;
        assert!((total - OPTIMAL_RETURN).abs() < 0.05, "{total}");
    }

    #[test]
    fn goals_and_cues_are_as_likely_as_stated_and_the_position_is_the_past_action() {
        let (task, spec) = resolve("toy").unwrap();
        let mut env = Env::new(task, &Arc::new(spec)).unwrap();
        let mut info = [0.0];
        let (mut steps, mut changes, mut right) = (0, 0, 0);
        for seed in 0..50 {
            env.reset(Some(seed)).unwrap();
            for step in 0..STEPS {
                let goal = env.observation()[3];
                right += u32::from(env.observation()[1] == goal);
                let action = if step % 3 == 0 { -0.75 } else { 0.5 };
                let transition = env.step(&[action], &mut info);
                assert_eq!(transition.reward, f64::from(action) * goal);
                assert_eq!(info, [goal]);
                assert!((env.observation()[0] - f64::from(action)).abs() < 2e-3);
                changes += u32::from(env.observation()[3] != goal);
                assert_eq!(transition.is_last(), step + 1 == STEPS);
                steps += 1;
            }
        }
        // Five standard deviations of binomials with n = 20 000.
        let near = |count: u32, p: f64| {
            let n = f64::from(steps);
            (f64::from(count) - n * p).abs() < 5.0 * (n * p * (1.0 - p)).sqrt()
        };
        assert!(near(changes, CHANGE) && near(right, RIGHT), "{changes} {right} of {steps}");
    }
}
