//! Ends an inference that takes too long.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

use ort::session::RunOptions;

/// How often a running inference is looked at.
const PERIOD: Duration = Duration::from_millis(50);
const IDLE: u64 = 0;

/// Watches one session from a thread of its own, which ends with it.
///
/// Starting and ending an inference is one atomic store each; only the watching thread sleeps and
/// wakes.
pub(crate) struct Watchdog {
    created: Instant,
    /// Microseconds from `created` to the start of the running inference, or [`IDLE`].
    started_us: Arc<AtomicU64>,
    options: Arc<RunOptions>,
    limit: Duration,
    /// Dropped to end the thread.
    _alive: Sender<()>,
}

impl Watchdog {
    pub(crate) fn new(limit: Duration) -> ort::Result<Self> {
        let created = Instant::now();
        let started_us = Arc::new(AtomicU64::new(IDLE));
        let options = Arc::new(RunOptions::new()?);
        let (alive, gone) = channel();
        let watched = (Arc::clone(&started_us), Arc::clone(&options));
        std::thread::spawn(move || {
            let (started_us, options) = watched;
            while gone.recv_timeout(PERIOD) == Err(RecvTimeoutError::Timeout) {
                let started_us = started_us.load(Ordering::Acquire);
                let running = created.elapsed().saturating_sub(Duration::from_micros(started_us));
                if started_us != IDLE && running > limit {
                    // It fails only if the flag cannot be set; then there is nothing else to try.
                    let _ = options.terminate();
                }
            }
        });
        Ok(Self { created, started_us, options, limit, _alive: alive })
    }

    pub(crate) fn limit(&self) -> Duration {
        self.limit
    }

    /// Options under which to run while the returned guard lives.
    pub(crate) fn watch(&self) -> (Arc<RunOptions>, Watch<'_>) {
        let now_us = self.created.elapsed().as_micros() as u64;
        self.started_us.store(now_us.max(IDLE + 1), Ordering::Release);
        (Arc::clone(&self.options), Watch { watchdog: self, started: Instant::now() })
    }
}

/// An inference under watch.
pub(crate) struct Watch<'a> {
    watchdog: &'a Watchdog,
    started: Instant,
}

impl Watch<'_> {
    pub(crate) fn is_overdue(&self) -> bool {
        self.started.elapsed() > self.watchdog.limit
    }
}

impl Drop for Watch<'_> {
    fn drop(&mut self) {
        self.watchdog.started_us.store(IDLE, Ordering::Release);
        if self.is_overdue() {
            // The flag may have been set: clear it for the next inference.
            let _ = self.watchdog.options.unterminate();
        }
    }
}
