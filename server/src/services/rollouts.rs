//! What evaluation and collection share: admission, a thread of their own, and a stream of
//! results that ends the work when its reader goes.

use std::pin::Pin;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use futures_util::Stream;
use palr_gym_core::{ActionMode, SceneOptions};
use tokio::runtime::Handle;
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::{SendTimeoutError, TrySendError};
use tokio_stream::wrappers::ReceiverStream;
use tokio_util::sync::{CancellationToken, DropGuard};
use tonic::Status;

use super::Services;
use crate::error::ServerError;
use crate::rollout::{Actor, DEFAULT_NUM_ENVS, Plan, PolicyChoice};

/// Results that may wait for their reader; beyond, the work waits.
const QUEUED_RESULTS: usize = 4;

pub(super) type ResultStream<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

/// Where a rollout puts its results.
pub(super) struct Results<T> {
    sender: mpsc::Sender<Result<T, Status>>,
    at_work: Arc<AtomicUsize>,
    unread: Duration,
    /// The reader was waited for in vain.
    is_unread: AtomicBool,
}

impl<T> Results<T> {
    /// Hands on one result; `false` if nobody reads any more, or not for a long time.
    pub(super) fn send(&self, result: T) -> bool {
        let result = match self.sender.try_send(Ok(result)) {
            Err(TrySendError::Full(result)) => result,
            sent => return sent.is_ok(),
        };
        self.at_work.fetch_sub(1, Ordering::Relaxed);
        let sent = Handle::current().block_on(self.sender.send_timeout(result, self.unread));
        self.at_work.fetch_add(1, Ordering::Relaxed);
        if let Err(SendTimeoutError::Timeout(_)) = sent {
            self.is_unread.store(true, Ordering::Relaxed);
        }
        sent.is_ok()
    }
}

/// Counts a rollout as at work until it is dropped.
struct AtWork(Arc<AtomicUsize>);

impl AtWork {
    fn begin(count: &Arc<AtomicUsize>) -> Self {
        count.fetch_add(1, Ordering::Relaxed);
        Self(Arc::clone(count))
    }
}

impl Drop for AtWork {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

/// A request for a rollout, after conversion.
pub(super) struct RolloutRequest {
    pub(super) env_id: String,
    /// `None`: the defaults.
    pub(super) scene: Option<SceneOptions>,
    pub(super) policy: PolicyChoice,
    pub(super) action_mode: ActionMode,
    pub(super) num_envs: Option<u32>,
    pub(super) seed: u64,
}

/// Why the work ended early. Not among the results: there may be no room left for it.
type Failure = Arc<Mutex<Option<Status>>>;

/// A stream that cancels its rollout when it is dropped.
struct Guarded<T> {
    results: ReceiverStream<Result<T, Status>>,
    failure: Failure,
    _guard: DropGuard,
}

impl<T> Stream for Guarded<T> {
    type Item = Result<T, Status>;

    fn poll_next(
        mut self: Pin<&mut Self>,
        context: &mut std::task::Context<'_>,
    ) -> std::task::Poll<Option<Self::Item>> {
        let polled = Pin::new(&mut self.results).poll_next(context);
        polled.map(|result| result.or_else(|| lock(&self.failure).take().map(Err)))
    }
}

fn lock(failure: &Failure) -> std::sync::MutexGuard<'_, Option<Status>> {
    // Nothing panics while it holds the lock.
    failure.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Services {
    /// Prepares a rollout and runs `work` on a thread of its own. Errors of the preparation are
    /// the call's error; later ones end the stream.
    pub(super) async fn roll_out<T: Send + 'static>(
        &self,
        request: RolloutRequest,
        work: impl FnOnce(&Plan, &mut Actor, &Results<T>) -> Result<(), ServerError> + Send + 'static,
    ) -> Result<ResultStream<T>, ServerError> {
        if self.draining.is_cancelled() {
            return Err(ServerError::Draining);
        }
        let max = self.limits.max_envs_per_session;
        let num_envs = request.num_envs.map_or(DEFAULT_NUM_ENVS, |count| count as usize);
        if !(1..=max).contains(&num_envs) {
            return Err(ServerError::NumEnvs { got: num_envs as u64, max });
        }
        let running = self.limits.max_rollouts;
        let permit = Arc::clone(&self.rollouts)
            .try_acquire_owned()
            .map_err(|_| ServerError::TooManyRollouts { running })?;
        let cancelled = CancellationToken::new();
        let (limits, vision) = (self.limits.policy, Arc::clone(&self.vision));
        let (threads, on_cancel) = (self.threads.clone(), cancelled.clone());
        let loaded = tokio::task::spawn_blocking(move || {
            let (task, spec, sight) = vision.resolve(&request.env_id, request.scene)?;
            let spec = Arc::new(spec);
            let actor = Actor::new(&request.policy, &spec, request.action_mode, limits)?;
            let (seed, cancelled) = (request.seed, on_cancel);
            let plan = Plan { task, spec, sight, num_envs, seed, threads, cancelled };
            plan.take_first_look()?;
            Ok::<_, ServerError>((actor, plan))
        });
        let (mut actor, plan) =
            loaded.await.map_err(|error| ServerError::Internal(error.to_string()))??;

        let (sender, receiver) = mpsc::channel(QUEUED_RESULTS);
        let failure = Failure::default();
        let told = Arc::clone(&failure);
        let draining = self.draining.clone();
        let on_drain = cancelled.clone();
        let watch = tokio::spawn(async move {
            draining.cancelled().await;
            on_drain.cancel();
        });
        let draining = self.draining.clone();
        let (at_work, unread) = (Arc::clone(&self.rollouts_at_work), self.limits.results_unread);
        tokio::task::spawn_blocking(move || {
            let _permit = permit;
            let _at_work = AtWork::begin(&at_work);
            let results = Results { sender, at_work, unread, is_unread: AtomicBool::new(false) };
            let run = std::panic::AssertUnwindSafe(|| work(&plan, &mut actor, &results));
            let end = std::panic::catch_unwind(run)
                .unwrap_or_else(|_| Err(ServerError::Internal("the rollout panicked".into())));
            watch.abort();
            if let Err(error) = end {
                let error = match error {
                    ServerError::Cancelled if draining.is_cancelled() => ServerError::Draining,
                    ServerError::Cancelled if results.is_unread.load(Ordering::Relaxed) => {
                        ServerError::NotRead { limit_s: unread.as_secs() }
                    }
                    error => error,
                };
                *lock(&told) = Some(error.into());
            }
        });
        Ok(Box::pin(Guarded {
            results: ReceiverStream::new(receiver),
            failure,
            _guard: cancelled.drop_guard(),
        }))
    }
}
