//! Environments that the agent acts in, on a server.

use palr_gym_proto::v1;

use crate::client::Client;
use crate::error::ClientError;
use crate::expert::replay::{Replay, Transition};
use crate::expert::settings::ExpertSettings;
use crate::session::Session;

/// N environments, each with what it shows now.
pub struct Collector {
    session: Session,
    observation_size: usize,
    action_size: usize,
    num_envs: usize,
    /// `[num_envs, observation size]`.
    observations: Vec<f32>,
    /// Of the step that is under way: what is learnt from.
    actions: Vec<f32>,
    /// What the environments got.
    sent: Vec<f32>,
    returns: Vec<f64>,
    /// Steps of the episodes under way.
    lengths: Vec<u64>,
    /// Episodes are cut after so many.
    episode_steps: u64,
}

/// What a step brought.
#[derive(Debug, Clone, Default)]
pub struct Collected {
    /// Transitions that were kept: all but those of a simulation that diverged.
    pub transitions: u64,
    /// Undiscounted returns of the episodes that ended or were cut.
    pub returns: Vec<f64>,
}

impl Collector {
    /// Opens as many environments as `settings` say and resets number i with `seed` + i.
    ///
    /// # Errors
    /// [`ClientError::Status`].
    pub async fn open(
        client: &Client,
        settings: &ExpertSettings,
        seed: u64,
    ) -> Result<Self, ClientError> {
        let num_envs = settings.num_envs;
        let request = v1::OpenSessionRequest {
            env_id: settings.env.clone(),
            num_envs: Some(num_envs as u32),
            autoreset_mode: v1::AutoresetMode::SameStep.into(),
            observation_dtype: v1::DataType::Float32.into(),
            ..v1::OpenSessionRequest::default()
        };
        let mut session = Session::open(client, request).await?;
        let size = |space: Option<&v1::BoxSpace>| {
            space.map_or(0, |space| space.shape.iter().product::<i64>() as usize)
        };
        let spec = session.spec();
        let observation_size = size(spec.observation_space.as_ref());
        let action_size = size(spec.action_space.as_ref());
        let answer = session.reset(vec![seed]).await?;
        let observations = floats(answer.observations, num_envs * observation_size)?;
        Ok(Self {
            session,
            observation_size,
            action_size,
            num_envs,
            observations,
            actions: Vec::new(),
            sent: Vec::new(),
            returns: vec![0.0; num_envs],
            lengths: vec![0; num_envs],
            episode_steps: settings.episode_steps.unwrap_or(u64::MAX),
        })
    }

    /// Width of an observation.
    #[must_use]
    pub fn observation_size(&self) -> usize {
        self.observation_size
    }

    /// Width of an action.
    #[must_use]
    pub fn action_size(&self) -> usize {
        self.action_size
    }

    /// What the environments show, `[num_envs, observation size]`.
    #[must_use]
    pub fn observations(&self) -> &[f32] {
        &self.observations
    }

    /// Begins a step with `actions`, `[num_envs, action size]`. The environments get `pushes` on top,
    /// as many or none; the replay does not.
    ///
    /// # Errors
    /// [`ClientError::Status`].
    pub fn send(&mut self, actions: &[f32], pushes: &[f32]) -> Result<(), ClientError> {
        // tanh rounds to 1 in single precision; an action of exactly ±1 has no finite density.
        const LARGEST: f32 = 1.0 - f32::EPSILON / 2.0;
        let inside = |action: f32| action.clamp(-LARGEST, LARGEST);
        self.actions.clear();
        self.actions.extend(actions.iter().map(|&action| inside(action)));
        if pushes.is_empty() {
            return self.session.send_step(&self.actions);
        }
        self.sent.clear();
        let pairs = self.actions.iter().zip(pushes);
        self.sent.extend(pairs.map(|(action, push)| inside(action + push)));
        self.session.send_step(&self.sent)
    }

    /// Ends the step that [`Self::send`] began, and keeps what it brought in `replay`. Episodes that are
    /// long enough are cut.
    ///
    /// # Errors
    /// [`ClientError::Status`], [`ClientError::Protocol`].
    pub async fn receive(&mut self, replay: &mut Replay) -> Result<Collected, ClientError> {
        let answer = self.session.receive_step().await?;
        let (n, width) = (self.num_envs, self.observation_size);
        let observations = floats(answer.observations, n * width)?;
        let rewards = bytes(answer.rewards, n * size_of::<f64>())?;
        let terminated = bytes(answer.terminated, n)?;
        let truncated = bytes(answer.truncated, n)?;
        let ended = |env: usize| terminated[env] != 0 || truncated[env] != 0;
        let finals = (0..n).filter(|&env| ended(env)).count();
        let finals = match finals {
            0 => Vec::new(),
            count => floats(answer.final_observations, count * width)?,
        };
        let mut finals = finals.chunks_exact(width);
        let mut collected = Collected::default();
        let mut cut = Vec::new();
        for (env, reward) in rewards.chunks_exact(size_of::<f64>()).enumerate() {
            let reward = f64::from_le_bytes(reward.try_into().unwrap_or_default());
            let row = env * width..(env + 1) * width;
            let next_observation = match ended(env) {
                true => finals.next().unwrap_or_default(),
                false => &observations[row.clone()],
            };
            // The last reward and observation of a diverged simulation are not its own.
            let is_sound = answer.diverged.iter().all(|episode| episode.env_index as usize != env);
            if is_sound {
                replay.push(Transition {
                    observation: &self.observations[row],
                    action: &self.actions[env * self.action_size..][..self.action_size],
                    reward: reward as f32,
                    next_observation,
                    terminated: terminated[env] != 0,
                });
                collected.transitions += 1;
            }
            self.returns[env] += reward;
            self.lengths[env] += 1;
            let is_cut = !ended(env) && self.lengths[env] >= self.episode_steps;
            if is_cut {
                cut.push(env as u32);
            }
            if ended(env) || is_cut {
                collected.returns.push(std::mem::take(&mut self.returns[env]));
                self.lengths[env] = 0;
            }
        }
        self.observations = observations;
        if !cut.is_empty() {
            let answer = self.session.reset_envs(cut, vec![]).await?;
            self.observations = floats(answer.observations, n * width)?;
        }
        Ok(collected)
    }

    /// Closes the session.
    ///
    /// # Errors
    /// [`ClientError::Status`].
    pub async fn close(self) -> Result<(), ClientError> {
        self.session.close().await
    }
}

fn bytes(tensor: Option<v1::Tensor>, want: usize) -> Result<bytes::Bytes, ClientError> {
    let data = tensor.map(|tensor| tensor.data).unwrap_or_default();
    if data.len() != want {
        let message = format!("a tensor has {} bytes; expected {want}", data.len());
        return Err(ClientError::Protocol(message));
    }
    Ok(data)
}

fn floats(tensor: Option<v1::Tensor>, want: usize) -> Result<Vec<f32>, ClientError> {
    Ok(bytemuck::pod_collect_to_vec(&bytes(tensor, want * size_of::<f32>())?))
}
