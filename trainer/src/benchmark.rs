//! Measures a server through the client: how many steps it takes, and how long one takes.
//!
//! The load is a random policy: uniform actions from a fixed seed, environments reset as their
//! episodes end (NEXT_STEP). Steps that only reset take time and are not counted.

use std::time::{Duration, Instant};

use palr_gym_core::random::Generator;
use palr_gym_proto::v1;
use serde::Serialize;

use crate::client::Client;
use crate::error::ClientError;
use crate::session::Session;

/// What to measure with.
#[derive(Debug, Clone)]
pub struct BenchmarkOptions {
    /// Environment, such as hopper-w2.
    pub env_id: String,
    /// Environments side by side in one session.
    pub num_envs: u32,
    /// How long each repeat lasts, after a warm-up of a tenth of that.
    pub duration: Duration,
    /// How often it is measured.
    pub repeats: u32,
    /// Of the environments and of the actions.
    pub seed: u64,
}

/// Who was measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Subject {
    /// Version of the server.
    pub server_version: String,
    /// Its simulation threads.
    pub simulation_threads: u32,
    /// Canonical id of the environment.
    pub env_id: String,
    /// Environments side by side.
    pub num_envs: u32,
}

/// How fast a server steps.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StepRates {
    /// Who was measured.
    #[serde(flatten)]
    pub subject: Subject,
    /// Requests that were under way together.
    pub in_flight: u32,
    /// Environment steps per second, median of the repeats.
    pub steps_per_s: f64,
    /// Every repeat, in the order of measurement.
    pub repeats: Vec<StepRate>,
}

/// One repeat.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct StepRate {
    /// Environment steps; those that only reset are not counted.
    pub env_steps: u64,
    /// Seconds that they took.
    pub wall_time_s: f64,
    /// Environment steps per second.
    pub steps_per_s: f64,
}

/// How long a round trip takes, in microseconds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StepLatencies {
    /// Who was measured.
    #[serde(flatten)]
    pub subject: Subject,
    /// Steps of all environments, all repeats together.
    pub step: Latency,
    /// The same for a call that does nothing (GetServerInfo): what the way there and back costs.
    pub empty_call: Latency,
}

/// A distribution, in microseconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Latency {
    /// Round trips.
    pub count: usize,
    /// Arithmetic mean.
    pub mean_us: f64,
    /// Half of the round trips took no longer.
    pub p50_us: f64,
    /// Nine in ten.
    pub p90_us: f64,
    /// 99 in 100.
    pub p99_us: f64,
    /// The longest.
    pub max_us: f64,
}

impl Latency {
    /// Of at least one round trip.
    fn of(mut seconds: Vec<f64>) -> Self {
        seconds.sort_by(f64::total_cmp);
        // Nearest rank: the smallest value that so many are not above.
        let percentile = |percent: usize| {
            let rank = (seconds.len() * percent).div_ceil(100).max(1);
            seconds.get(rank - 1).copied().unwrap_or(f64::NAN) * 1e6
        };
        Self {
            count: seconds.len(),
            mean_us: seconds.iter().sum::<f64>() / seconds.len() as f64 * 1e6,
            p50_us: percentile(50),
            p90_us: percentile(90),
            p99_us: percentile(99),
            max_us: percentile(100),
        }
    }
}

/// Measures how many steps a server takes with `in_flight` requests under way, at least one.
/// `on_progress` is told now and then how much time of all repeats has passed.
///
/// # Errors
/// [`ClientError::Status`].
pub async fn step_rates(
    client: &Client,
    options: &BenchmarkOptions,
    in_flight: u32,
    mut on_progress: impl FnMut(Duration),
) -> Result<StepRates, ClientError> {
    let (mut session, subject) = open(client, options).await?;
    let mut load = Load::new(&session, options.seed);
    session.reset(vec![options.seed]).await?;
    run_steps(&mut session, &mut load, in_flight, options.duration / 10, |_| {}).await?;
    let mut repeats = Vec::new();
    for repeat in 0..options.repeats {
        let before = options.duration * repeat;
        let rate = run_steps(&mut session, &mut load, in_flight, options.duration, |elapsed| {
            on_progress(before + elapsed);
        })
        .await?;
        repeats.push(rate);
    }
    session.close().await?;
    let mut rates: Vec<f64> = repeats.iter().map(|repeat| repeat.steps_per_s).collect();
    rates.sort_by(f64::total_cmp);
    // Of an even number of repeats the lower middle: one that was measured.
    let steps_per_s = rates.get(rates.len().saturating_sub(1) / 2).copied().unwrap_or(f64::NAN);
    Ok(StepRates { subject, in_flight, steps_per_s, repeats })
}

/// Measures how long a step takes, one request at a time. `on_progress` as in [`step_rates`].
///
/// # Errors
/// [`ClientError::Status`].
pub async fn step_latencies(
    client: &Client,
    options: &BenchmarkOptions,
    mut on_progress: impl FnMut(Duration),
) -> Result<StepLatencies, ClientError> {
    let (mut session, subject) = open(client, options).await?;
    let mut load = Load::new(&session, options.seed);
    session.reset(vec![options.seed]).await?;
    run_steps(&mut session, &mut load, 1, options.duration / 10, |_| {}).await?;
    let mut steps = Vec::new();
    let mut empty_calls = Vec::new();
    for repeat in 0..options.repeats {
        let before = options.duration * repeat;
        let started = Instant::now();
        // A tenth of the time for calls that do nothing, beside the steps they are held against.
        while started.elapsed() < options.duration / 10 || empty_calls.is_empty() {
            let sent = Instant::now();
            client.server_info().await?;
            empty_calls.push(sent.elapsed().as_secs_f64());
        }
        while started.elapsed() < options.duration || steps.is_empty() {
            let sent = Instant::now();
            session.step(load.next_actions()).await?;
            steps.push(sent.elapsed().as_secs_f64());
            on_progress(before + started.elapsed());
        }
    }
    session.close().await?;
    let (step, empty_call) = (Latency::of(steps), Latency::of(empty_calls));
    Ok(StepLatencies { subject, step, empty_call })
}

async fn open(
    client: &Client,
    options: &BenchmarkOptions,
) -> Result<(Session, Subject), ClientError> {
    let info = client.server_info().await?;
    let request = v1::OpenSessionRequest {
        env_id: options.env_id.clone(),
        num_envs: Some(options.num_envs),
        ..v1::OpenSessionRequest::default()
    };
    let session = Session::open(client, request).await?;
    let subject = Subject {
        server_version: info.version,
        simulation_threads: info.simulation_threads,
        env_id: session.spec().env_id.clone(),
        num_envs: session.num_envs() as u32,
    };
    Ok((session, subject))
}

/// Actions of many steps, drawn beforehand, over and over.
struct Load {
    actions: Vec<f32>,
    row: usize,
    next: usize,
    /// Environments that the next answer's step only resets.
    resetting: u64,
}

/// Drawn beforehand at most, so that a session of thousands of environments does not wait for it.
const MAX_DRAWN: usize = 1 << 20;
const MAX_ROWS: usize = 256;

impl Load {
    fn new(session: &Session, seed: u64) -> Self {
        let action_size = session.spec().action_space.as_ref().map_or(0, |space| space.names.len());
        let row = (session.num_envs() * action_size).max(1);
        let rows = (MAX_DRAWN / row).clamp(1, MAX_ROWS);
        let mut generator = Generator::from_seed(seed);
        let actions = (0..rows * row).map(|_| generator.uniform(-1.0, 1.0) as f32).collect();
        Self { actions, row, next: 0, resetting: 0 }
    }

    fn next_actions(&mut self) -> &[f32] {
        let start = self.next;
        self.next = (start + self.row) % self.actions.len();
        &self.actions[start..start + self.row]
    }
}

/// Steps for `duration`, and at least once.
async fn run_steps(
    session: &mut Session,
    load: &mut Load,
    in_flight: u32,
    duration: Duration,
    mut on_progress: impl FnMut(Duration),
) -> Result<StepRate, ClientError> {
    let num_envs = session.num_envs() as u64;
    let started = Instant::now();
    let (mut sent, mut env_steps) = (0, 0);
    loop {
        let elapsed = started.elapsed();
        on_progress(elapsed);
        // In the end those under way are waited for: their time must not go to the next repeat.
        let goes_on = elapsed < duration || env_steps == 0;
        while goes_on && sent < in_flight.max(1) {
            session.send_step(load.next_actions())?;
            sent += 1;
        }
        if sent == 0 {
            break;
        }
        let answer = session.receive_step().await?;
        sent -= 1;
        env_steps += num_envs - load.resetting;
        load.resetting = ended(&answer);
    }
    let wall_time_s = started.elapsed().as_secs_f64();
    Ok(StepRate { env_steps, wall_time_s, steps_per_s: env_steps as f64 / wall_time_s })
}

/// Environments whose episode this step ended; the next step only resets them.
fn ended(answer: &v1::StepResponse) -> u64 {
    let flags = |tensor: &Option<v1::Tensor>| {
        tensor.as_ref().map(|tensor| tensor.data.clone()).unwrap_or_default()
    };
    flags(&answer.terminated)
        .iter()
        .zip(&flags(&answer.truncated))
        .filter(|(terminated, truncated)| **terminated | **truncated != 0)
        .count() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_of_nearest_rank() {
        // 1 to 200 microseconds, not in order.
        let seconds = (0..200).map(|i| f64::from((i * 77) % 200 + 1) * 1e-6).collect();
        let latency = Latency::of(seconds);
        let got = [latency.mean_us, latency.p50_us, latency.p90_us, latency.p99_us, latency.max_us];
        for (got, want) in got.into_iter().zip([100.5, 100.0, 180.0, 198.0, 200.0]) {
            assert!((got - want).abs() < 1e-9, "{got} is not {want}");
        }
        assert_eq!(latency.count, 200);
        let single = Latency::of(vec![2e-6]);
        assert_eq!((single.p50_us, single.p99_us, single.max_us), (2.0, 2.0, 2.0));
    }

    #[test]
    fn a_step_counts_as_ended_once_however_it_ended() {
        let flags =
            |bytes: &'static [u8]| Some(v1::Tensor { data: bytes.into(), ..v1::Tensor::default() });
        let answer = v1::StepResponse {
            terminated: flags(&[0, 1, 0, 1]),
            truncated: flags(&[0, 0, 1, 1]),
            ..v1::StepResponse::default()
        };
        assert_eq!(ended(&answer), 3);
    }
}
