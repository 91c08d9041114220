//! Soft actor-critic: the networks and their update.

use pulp::{Arch, Simd};

use crate::expert::actor::{self, Drawn};
use crate::expert::critic::{self, CriticKind, Returns};
use crate::expert::mlp::{self, Tape, Wanted};
use crate::expert::settings::ExpertSettings;
use crate::learning::error::TrainError;
use crate::learning::network::{Initialization, LayerShape, Network};

/// Actor, two critics with their slow copies, and the temperature.
#[derive(Debug, Clone)]
pub struct Agent {
    observation_size: usize,
    action_size: usize,
    rule: Rule,
    /// As [`actor::layers`].
    pub actor: Network,
    /// The actor's parameters, averaged over time: what is evaluated and exported.
    pub averaged_actor: Vec<f32>,
    /// As [`critic::layers`].
    pub critics: [Network; 2],
    /// The critics' parameters, averaged over time.
    pub targets: [Vec<f32>; 2],
    /// One parameter: log α.
    pub temperature: Network,
    /// Updates so far.
    pub updates: u64,
    scratch: Scratch,
}

/// What an update does, apart from its numbers.
#[derive(Debug, Clone, Copy)]
struct Rule {
    critic: CriticKind,
    outputs: usize,
    dropped: usize,
    learning_rate: f64,
    discount: f32,
    reward_cap: f32,
    healthy_z_range: [f32; 2],
    polyak: f32,
    target_entropy: f64,
    actor_every: u64,
    actor_average: f32,
}

impl Rule {
    fn new(settings: &ExpertSettings, action_size: usize) -> Self {
        let (outputs, dropped) = returns(settings);
        Self {
            critic: settings.critic,
            outputs,
            dropped,
            learning_rate: settings.learning_rate,
            discount: settings.discount as f32,
            reward_cap: settings.reward_cap.map_or(f32::INFINITY, |cap| cap as f32),
            healthy_z_range: settings
                .healthy_z_range
                .map_or([f32::NEG_INFINITY, f32::INFINITY], |range| range.map(|z| z as f32)),
            polyak: settings.polyak as f32,
            target_entropy: settings.target_entropy.unwrap_or(-(action_size as f64)),
            actor_every: settings.actor_every,
            actor_average: settings.actor_average as f32,
        }
    }
}

/// How many returns a critic tells, and how many of both critics' are dropped.
fn returns(settings: &ExpertSettings) -> (usize, usize) {
    match settings.critic {
        CriticKind::Sac => (1, 1),
        CriticKind::Tqc => (settings.quantiles, 2 * settings.dropped_quantiles),
    }
}

/// Transitions to learn from.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Batch {
    /// `[n, observation size]`.
    pub observations: Vec<f32>,
    /// `[n, action size]`.
    pub actions: Vec<f32>,
    /// `[n]`.
    pub rewards: Vec<f32>,
    /// `[n, observation size]`.
    pub next_observations: Vec<f32>,
    /// `[n]`: 0 where the task ended the episode, else 1; a time limit ends nothing.
    pub continues: Vec<f32>,
}

impl Batch {
    /// Its arrays with their names in files, in the order of their fields.
    #[must_use]
    pub fn arrays(&self) -> [(&'static str, &[f32]); 5] {
        [
            ("observations", &self.observations),
            ("actions", &self.actions),
            ("rewards", &self.rewards),
            ("next_observations", &self.next_observations),
            ("continues", &self.continues),
        ]
    }

    /// As [`Self::arrays`].
    pub fn arrays_mut(&mut self) -> [(&'static str, &mut Vec<f32>); 5] {
        [
            ("observations", &mut self.observations),
            ("actions", &mut self.actions),
            ("rewards", &mut self.rewards),
            ("next_observations", &mut self.next_observations),
            ("continues", &mut self.continues),
        ]
    }
}

/// Normal numbers of an update, `[n, action size]` each.
#[derive(Debug, Clone, Default)]
pub struct UpdateNoise {
    /// Of the actions of [`Batch::observations`].
    pub present: Vec<f32>,
    /// Of the actions of [`Batch::next_observations`].
    pub next: Vec<f32>,
}

/// What an update measured, before it changed anything.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Losses {
    /// Sum of both critics' losses.
    pub critic: f64,
    /// mean(α log π - value); none where the update left the actor alone.
    pub actor: Option<f64>,
    /// Mean value of the policy's actions; none where the update left the actor alone.
    pub value: Option<f64>,
    /// mean(-log π), in nats.
    pub entropy: f64,
    /// α.
    pub temperature: f64,
}

#[derive(Debug, Clone, Default)]
struct Scratch {
    present: Drawn,
    next: Drawn,
    tapes: [Tape; 2],
    inputs: Vec<f32>,
    continues: Vec<f32>,
    next_cost: Vec<f32>,
    targets: Vec<f32>,
    output_gradients: [Vec<f32>; 2],
    input_gradients: [Vec<f32>; 2],
    value_gradient: Vec<f32>,
    flat: Vec<f32>,
}

impl Agent {
    /// Before its first update.
    #[must_use]
    pub fn new(settings: &ExpertSettings, observation_size: usize, action_size: usize) -> Self {
        let (outputs, _) = returns(settings);
        let network = |name, layers, number| {
            Network::new(name, layers, Initialization::Uniform, settings.seed, number)
        };
        let critic_layers =
            || critic::layers(observation_size + action_size, settings.hidden, outputs);
        let critics =
            [network("critic_1", critic_layers(), 1), network("critic_2", critic_layers(), 2)];
        let layers = vec![LayerShape::new("log", 1, 1).without_bias()];
        let mut temperature = network("temperature", layers, 3);
        temperature.parameters = vec![settings.initial_temperature.ln() as f32];
        let actor_layers = actor::layers(observation_size, settings.hidden, action_size);
        let actor = network("actor", actor_layers, 0);
        Self {
            observation_size,
            action_size,
            rule: Rule::new(settings, action_size),
            averaged_actor: actor.parameters.clone(),
            actor,
            targets: [critics[0].parameters.clone(), critics[1].parameters.clone()],
            critics,
            temperature,
            updates: 0,
            scratch: Scratch::default(),
        }
    }

    /// Learns by `settings` from here on; what its networks are stays.
    pub fn follow(&mut self, settings: &ExpertSettings) {
        self.rule = Rule::new(settings, self.action_size);
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

    /// Its networks, in the order of their numbers.
    #[must_use]
    pub fn networks(&self) -> [&Network; 4] {
        [&self.actor, &self.critics[0], &self.critics[1], &self.temperature]
    }

    /// As [`Self::networks`].
    pub fn networks_mut(&mut self) -> [&mut Network; 4] {
        let [first, second] = &mut self.critics;
        [&mut self.actor, first, second, &mut self.temperature]
    }

    /// Sampled actions for `observations`, `[n, observation size]`, with `noise`,
    /// `[n, action size]`.
    pub fn act(&mut self, observations: &[f32], noise: &[f32]) -> &[f32] {
        let n = observations.len() / self.observation_size;
        let Network { layers, parameters, .. } = &self.actor;
        self.scratch.present.draw(layers, parameters, observations, noise, n);
        &self.scratch.present.actions
    }

    /// One update: temperature, critics, actor, slow copies.
    ///
    /// # Source
    /// Haarnoja et al. (2018), "Soft Actor-Critic Algorithms and Applications", algorithm 1, with a
    /// loss of log α instead of α; Kuznetsov et al. (2020) for quantiles.
    ///
    /// # Errors
    /// [`TrainError::Diverged`].
    pub fn update(&mut self, batch: &Batch, noise: &UpdateNoise) -> Result<Losses, TrainError> {
        let Rule { critic: kind, outputs, dropped, learning_rate, .. } = self.rule;
        let (action_size, n) = (self.action_size, batch.rewards.len());
        let step = self.updates + 1;
        let Scratch {
            present,
            next,
            tapes,
            inputs,
            continues,
            next_cost,
            targets,
            output_gradients,
            input_gradients,
            value_gradient,
            flat,
        } = &mut self.scratch;

        let Network { layers, parameters, .. } = &self.actor;
        present.draw(layers, parameters, &batch.observations, &noise.present, n);
        next.draw(layers, parameters, &batch.next_observations, &noise.next, n);

        let log_density = present.log_density.iter().map(|&value| f64::from(value)).sum::<f64>();
        let log_density = log_density / n as f64;
        let temperature = self.temperature.parameters[0].exp();
        let slope = -(log_density + self.rule.target_entropy);
        self.temperature.descend(&[slope as f32], learning_rate, step)?;

        joined(inputs, &batch.next_observations, &next.actions, action_size);
        let layers = &self.critics[0].layers;
        for (tape, parameters) in tapes.iter_mut().zip(&self.targets) {
            mlp::forward(layers, parameters, inputs, n, tape);
        }
        let [least, greatest] = self.rule.healthy_z_range;
        let heights = batch.next_observations.iter().step_by(self.observation_size);
        let is_healthy = heights.map(|height| (least..=greatest).contains(height));
        continues.clear();
        let pairs = batch.continues.iter().zip(is_healthy);
        continues
            .extend(pairs.map(|(&goes_on, is_healthy)| if is_healthy { goes_on } else { 0.0 }));
        next_cost.clear();
        next_cost.extend(next.log_density.iter().map(|value| temperature * value));
        let returns = Returns {
            rewards: &batch.rewards,
            reward_cap: self.rule.reward_cap,
            continues,
            discount: self.rule.discount,
            next_cost,
        };
        critic::targets([tapes[0].output(), tapes[1].output()], outputs, dropped, returns, targets);

        joined(inputs, &batch.observations, &batch.actions, action_size);
        let mut losses = Losses {
            entropy: -log_density,
            temperature: f64::from(temperature),
            ..Losses::default()
        };
        let gradient = &mut output_gradients[0];
        for (network, tape) in self.critics.iter_mut().zip(tapes.iter_mut()) {
            mlp::forward(&network.layers, &network.parameters, inputs, n, tape);
            losses.critic += match kind {
                CriticKind::Sac => critic::squared_loss(tape.output(), targets, gradient),
                CriticKind::Tqc => critic::quantile_loss(outputs, tape.output(), targets, gradient),
            };
            flat.resize(network.parameters.len(), 0.0);
            let wanted = Wanted::Parameters(flat);
            let Network { layers, parameters, .. } = &*network;
            mlp::backward(layers, parameters, inputs, tape, gradient, wanted);
            network.descend(flat, learning_rate, step)?;
        }

        if step.is_multiple_of(self.rule.actor_every) {
            joined(inputs, &batch.observations, &present.actions, action_size);
            for (network, tape) in self.critics.iter().zip(tapes.iter_mut()) {
                mlp::forward(&network.layers, &network.parameters, inputs, n, tape);
            }
            let values = [tapes[0].output(), tapes[1].output()];
            let value = critic::actor_value(kind, values, outputs, output_gradients.each_mut());
            let ways = self.critics.iter().zip(tapes.iter_mut());
            let gradients = output_gradients.iter().zip(input_gradients.iter_mut());
            for ((network, tape), (gradient, input_gradient)) in ways.zip(gradients) {
                let Network { layers, parameters, .. } = network;
                let wanted = Wanted::Input(input_gradient);
                mlp::backward(layers, parameters, inputs, tape, gradient, wanted);
            }
            value_gradient.clear();
            let width = self.observation_size + action_size;
            let rows = input_gradients[0].chunks_exact(width);
            for (first, second) in rows.zip(input_gradients[1].chunks_exact(width)) {
                let pairs = first.iter().zip(second).skip(self.observation_size);
                value_gradient.extend(pairs.map(|(first, second)| first + second));
            }
            flat.resize(self.actor.parameters.len(), 0.0);
            let Network { layers, parameters, .. } = &self.actor;
            let observations = &batch.observations;
            present.gradient(layers, parameters, observations, temperature, value_gradient, flat);
            self.actor.descend(flat, learning_rate, step / self.rule.actor_every)?;
            match self.rule.actor_average {
                1.0 => self.averaged_actor.copy_from_slice(&self.actor.parameters),
                share => follow(&mut self.averaged_actor, &self.actor.parameters, share),
            }
            losses.actor = Some(f64::from(temperature) * log_density - value);
            losses.value = Some(value);
        }

        let polyak = self.rule.polyak;
        for (slow, network) in self.targets.iter_mut().zip(&self.critics) {
            follow(slow, &network.parameters, polyak);
        }
        self.updates = step;
        Ok(losses)
    }
}

/// Moves each of `slow` by a `share` of its way to `parameters`.
#[pulp::with_simd(follow = Arch::new())]
#[inline(always)]
fn follow_with_simd<'a, S: Simd>(_simd: S, slow: &'a mut [f32], parameters: &'a [f32], share: f32) {
    for (slow, parameter) in slow.iter_mut().zip(parameters) {
        *slow += share * (parameter - *slow);
    }
}

/// Rows of observations with their actions behind them.
fn joined(rows: &mut Vec<f32>, observations: &[f32], actions: &[f32], action_size: usize) {
    rows.clear();
    let n = actions.len() / action_size;
    let observations = observations.chunks_exact(observations.len() / n);
    for (observation, action) in observations.zip(actions.chunks_exact(action_size)) {
        rows.extend_from_slice(observation);
        rows.extend_from_slice(action);
    }
}
