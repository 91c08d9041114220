//! `palr-gym serve`

use std::net::{Ipv4Addr, SocketAddr};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use palr_gym_server::{Limits, Listener, Server, ServerConfig};
use palr_gym_vision::{Extractor, ExtractorLimits};
use serde::Serialize;
use tokio::signal::unix::{SignalKind, signal};

use crate::cli::ServeArguments;

/// PALR on a telephone's keys.
const DEFAULT_PORT: u16 = 7257;

/// What `--json` tells.
#[derive(Serialize)]
struct Ready {
    address: Option<String>,
    unix: Option<String>,
    version: &'static str,
    mujoco_version: &'static str,
}

/// Serves until a signal comes.
pub async fn run(arguments: ServeArguments) -> anyhow::Result<()> {
    let defaults = ServerConfig::default();
    let config = ServerConfig {
        simulation_threads: arguments.threads.map_or(defaults.simulation_threads, usize::from),
        gl: arguments.gl.choice,
        extractor: arguments.extractor.as_deref().map(read_extractor).transpose()?,
        limits: Limits {
            max_connections: arguments.max_connections,
            max_sessions: arguments.max_sessions,
            max_envs_per_session: arguments.max_envs_per_session,
            session_idle: Duration::from_secs(arguments.session_idle),
            ..defaults.limits
        },
        ..defaults
    };
    let threads = config.simulation_threads;
    // Before anything can be asked to stop.
    let (mut interrupt, mut terminate) =
        (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
    let default_address = SocketAddr::from((Ipv4Addr::LOCALHOST, DEFAULT_PORT));
    let address = arguments.listen.or_else(|| arguments.unix.is_none().then_some(default_address));
    let mut listeners = Vec::new();
    let mut ready = Ready {
        address: None,
        unix: None,
        version: palr_gym_server::VERSION,
        mujoco_version: palr_gym_sim::mujoco_log::mujoco_version(),
    };
    if let Some(address) = address {
        let listener = Listener::tcp(address).await?;
        ready.address = listener.local_address().map(|address| address.to_string());
        listeners.push(listener);
    }
    if let Some(path) = &arguments.unix {
        listeners.push(Listener::unix(path)?);
        ready.unix = Some(path.display().to_string());
    }
    let server = Server::new(config)?;
    announce(&ready, threads, arguments.json)?;
    server
        .serve(listeners, async move {
            tokio::select! {
                _ = interrupt.recv() => tracing::info!("interrupted"),
                _ = terminate.recv() => tracing::info!("asked to terminate"),
            }
        })
        .await?;
    tracing::info!("stopped");
    Ok(())
}

fn read_extractor(path: &Path) -> anyhow::Result<Arc<Extractor>> {
    let read = Extractor::read(path, ExtractorLimits::default());
    Ok(Arc::new(read.with_context(|| format!("--extractor {}", path.display()))?))
}

fn announce(ready: &Ready, threads: usize, json: bool) -> anyhow::Result<()> {
    if json {
        println!("{}", serde_json::to_string(ready)?);
        return Ok(());
    }
    let unix = ready.unix.as_ref().map(|path| format!("unix:{path}"));
    let places: Vec<String> = ready.address.iter().cloned().chain(unix).collect();
    println!(
        "palr-gym {} (MuJoCo {}) serves on {} with {threads} simulation threads; Ctrl-C stops it",
        ready.version,
        ready.mujoco_version,
        places.join(" and "),
    );
    Ok(())
}
