//! Ctrl-C and SIGTERM, for work that keeps what it has.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use tokio::signal::unix::{SignalKind, signal};

/// Exit code of a process that was interrupted.
pub const EXIT_INTERRUPTED: u8 = 130;

/// The work was stopped by a signal and can go on later; no failure.
#[derive(Debug)]
pub struct Interrupted {
    /// Where it stands and how to go on.
    pub message: String,
}

impl std::fmt::Display for Interrupted {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(&self.message)
    }
}

impl std::error::Error for Interrupted {}

/// True after the first SIGINT or SIGTERM. A second one ends the process at once.
pub fn stop_on_signals() -> Arc<AtomicBool> {
    let is_stopped = Arc::new(AtomicBool::new(false));
    for kind in [SignalKind::interrupt(), SignalKind::terminate()] {
        let is_stopped = Arc::clone(&is_stopped);
        // Without a handler, a signal ends the process: a checkpoint is there all the same.
        let Ok(mut signals) = signal(kind) else { continue };
        tokio::spawn(async move {
            while signals.recv().await.is_some() {
                if is_stopped.swap(true, Ordering::Relaxed) {
                    std::process::exit(i32::from(EXIT_INTERRUPTED));
                }
            }
        });
    }
    is_stopped
}
