//! What steps return.

use palr_gym_core::{AutoresetMode, EnvSpec};

use crate::divergence::Divergence;

/// An episode that was cut short because the simulation diverged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DivergedEpisode {
    /// In which of the frame's steps.
    pub step: usize,
    /// Which environment.
    pub env_index: usize,
    /// Why.
    pub divergence: Divergence,
}

/// What K steps of N environments return, in row-major order; K is 1 unless it was asked for more.
/// The buffers are reused.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StepFrame {
    /// K.
    pub steps: usize,
    /// `[steps, num_envs, observation_size]`.
    pub observations: Vec<f64>,
    /// `[steps, num_envs]`.
    pub rewards: Vec<f64>,
    /// `[steps, num_envs]`.
    pub terminated: Vec<bool>,
    /// `[steps, num_envs]`.
    pub truncated: Vec<bool>,
    /// `[steps, num_envs, info_names]`; NaN in rows in which the simulation diverged, and in those
    /// that this step reset, but for what a reset reports.
    pub info: Vec<f64>,
    /// `[steps, num_envs, observation_size]`; SAME_STEP only, and valid only in the rows whose
    /// episode this step ended.
    pub final_observations: Vec<f64>,
    /// `[steps, num_envs, reset_info_names]`; SAME_STEP only, and valid in the same rows.
    pub reset_info: Vec<f64>,
    /// Episodes that diverged, in the order of steps and environments. Hardly ever any.
    pub diverged: Vec<DivergedEpisode>,
    num_envs: usize,
    reset_info_size: usize,
}

/// The rows of one environment in one step.
pub(super) struct Row<'a> {
    pub(super) observation: &'a mut [f64],
    pub(super) reward: &'a mut f64,
    pub(super) terminated: &'a mut bool,
    pub(super) truncated: &'a mut bool,
    pub(super) info: &'a mut [f64],
    pub(super) final_observation: Option<&'a mut [f64]>,
    /// Room for what a reset reports: at the head of `info`, and (SAME_STEP) here.
    pub(super) reset_info_size: usize,
    pub(super) reset_info: Option<&'a mut [f64]>,
}

impl StepFrame {
    /// Makes room for `steps` steps; what is there of them stays.
    pub(super) fn resize(
        &mut self,
        steps: usize,
        num_envs: usize,
        spec: &EnvSpec,
        mode: AutoresetMode,
    ) {
        let count = steps * num_envs;
        let observation_count = count * spec.observation_size();
        self.steps = steps;
        self.num_envs = num_envs;
        self.observations.resize(observation_count, 0.0);
        self.rewards.resize(count, 0.0);
        self.terminated.resize(count, false);
        self.truncated.resize(count, false);
        self.info.resize(count * spec.task.info_names.len(), 0.0);
        self.reset_info_size = spec.task.reset_info_names.len();
        let has_final = usize::from(mode == AutoresetMode::SameStep);
        self.final_observations.resize(has_final * observation_count, 0.0);
        self.reset_info.resize(has_final * count * self.reset_info_size, 0.0);
    }

    /// Brings them into their order: they come piece by piece.
    pub(super) fn sort_divergences(&mut self) {
        self.diverged.sort_unstable_by_key(|diverged| (diverged.step, diverged.env_index));
    }

    /// True if an episode ended in step `step`.
    pub(super) fn has_end(&self, step: usize) -> bool {
        let rows = step * self.num_envs..(step + 1) * self.num_envs;
        self.terminated[rows.clone()].contains(&true) || self.truncated[rows].contains(&true)
    }

    /// The row of environment `env` in step `step`.
    pub(super) fn row(&mut self, step: usize, env: usize) -> Row<'_> {
        let index = step * self.num_envs + env;
        let count = self.rewards.len();
        let size = self.observations.len() / count;
        let info_size = self.info.len() / count;
        let reset_size = self.reset_info_size;
        Row {
            observation: &mut self.observations[index * size..(index + 1) * size],
            reward: &mut self.rewards[index],
            terminated: &mut self.terminated[index],
            truncated: &mut self.truncated[index],
            info: &mut self.info[index * info_size..(index + 1) * info_size],
            final_observation: self.final_observations.get_mut(index * size..(index + 1) * size),
            reset_info_size: reset_size,
            reset_info: self.reset_info.get_mut(index * reset_size..(index + 1) * reset_size),
        }
    }

    /// Copies the steps of a piece, whose first environment is our `first_env`, to our steps from
    /// `first_step` on.
    pub(super) fn take_in(&mut self, piece: &Self, first_step: usize, first_env: usize) {
        let (ours, theirs) = (self.rewards.len(), piece.rewards.len());
        for step in 0..piece.steps {
            let rows = Rows {
                from: step * piece.num_envs,
                of: theirs,
                to: (first_step + step) * self.num_envs + first_env,
                among: ours,
                count: piece.num_envs,
            };
            rows.copy(&piece.observations, &mut self.observations);
            rows.copy(&piece.rewards, &mut self.rewards);
            rows.copy(&piece.terminated, &mut self.terminated);
            rows.copy(&piece.truncated, &mut self.truncated);
            rows.copy(&piece.info, &mut self.info);
            rows.copy(&piece.final_observations, &mut self.final_observations);
            rows.copy(&piece.reset_info, &mut self.reset_info);
        }
        self.diverged.extend(piece.diverged.iter().map(|diverged| DivergedEpisode {
            step: first_step + diverged.step,
            env_index: first_env + diverged.env_index,
            ..*diverged
        }));
    }
}

/// `count` neighbouring rows in arrays of `of` and `among` rows.
struct Rows {
    from: usize,
    of: usize,
    to: usize,
    among: usize,
    count: usize,
}

impl Rows {
    fn copy<T: Copy>(&self, source: &[T], target: &mut [T]) {
        let (from, to) = (source.len() / self.of, target.len() / self.among);
        target[self.to * to..(self.to + self.count) * to]
            .copy_from_slice(&source[self.from * from..(self.from + self.count) * from]);
    }
}
