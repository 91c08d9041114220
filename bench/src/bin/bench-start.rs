//! How long a server takes from `exec` to its first SERVING, over a Unix socket.

use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};

use anyhow::{Context, ensure};
use clap::Parser;
use hyper_util::rt::TokioIo;
use palr_gym_bench::report;
use palr_gym_trainer::client::tuned;
use serde::Serialize;
use tokio::net::UnixStream;
use tonic::transport::{Endpoint, Uri};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

/// How often a server that does not listen yet is tried again.
const RETRY_PERIOD: Duration = Duration::from_micros(500);
/// A server that is not healthy by then will never be.
const GIVE_UP: Duration = Duration::from_secs(30);

#[derive(Debug, Parser)]
#[command(about = "Measures how long a server takes to be healthy")]
struct Cli {
    /// The binary palr-gym.
    #[arg(long)]
    binary: PathBuf,
    /// Where its socket goes.
    #[arg(long)]
    unix: PathBuf,
}

#[derive(Debug, Serialize)]
struct Start {
    healthy_ms: f64,
}

async fn connect(path: &Path, started: Instant) -> anyhow::Result<UnixStream> {
    loop {
        match UnixStream::connect(path).await {
            Ok(stream) => return Ok(stream),
            Err(error) => {
                ensure!(started.elapsed() < GIVE_UP, "no server listens on {path:?}: {error}");
                tokio::time::sleep(RETRY_PERIOD).await;
            }
        }
    }
}

async fn check(path: &Path, started: Instant) -> anyhow::Result<Start> {
    let mut stream = Some(TokioIo::new(connect(path, started).await?));
    let connector = tower::service_fn(move |_: Uri| {
        let stream = stream.take();
        async move { stream.ok_or(std::io::Error::from(std::io::ErrorKind::NotConnected)) }
    });
    let endpoint = tuned(Endpoint::from_static("http://localhost"));
    let mut health = HealthClient::new(endpoint.connect_with_connector(connector).await?);
    let answer = health.check(HealthCheckRequest::default()).await?.into_inner();
    let healthy_ms = started.elapsed().as_secs_f64() * 1e3;
    ensure!(answer.status() == ServingStatus::Serving, "the server is {:?}", answer.status());
    Ok(Start { healthy_ms })
}

fn main() -> anyhow::Result<()> {
    let cli = Cli::parse();
    // The client's own start is not the server's.
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let started = Instant::now();
    let mut server = std::process::Command::new(&cli.binary)
        .args(["serve", "--listen", "127.0.0.1:0", "--unix"])
        .arg(&cli.unix)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .with_context(|| format!("cannot start {:?}", cli.binary))?;
    let start = runtime.block_on(check(&cli.unix, started));
    server.kill()?;
    server.wait()?;
    // A server that is killed leaves its socket behind.
    let _ = std::fs::remove_file(&cli.unix);
    report(&start?)?;
    Ok(())
}
