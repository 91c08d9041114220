//! Listening, health, reflection, draining.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use palr_gym_proto::FILE_DESCRIPTOR_SET;
use palr_gym_proto::dm_env_rpc::v1::environment_server::EnvironmentServer;
use palr_gym_proto::v1::collection_service_server::CollectionServiceServer;
use palr_gym_proto::v1::environment_service_server::EnvironmentServiceServer;
use palr_gym_proto::v1::evaluation_service_server::EvaluationServiceServer;
use palr_gym_proto::v1::leakage_service_server::LeakageServiceServer;
use palr_gym_proto::v1::server_service_server::ServerServiceServer;
use palr_gym_proto::v1::snapshot_service_server::SnapshotServiceServer;
use palr_gym_sim::SimulationThreads;
use tokio::net::{TcpListener, UnixListener};
use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::UnixListenerStream;
use tokio_util::sync::CancellationToken;
use tonic::server::NamedService;
use tonic::service::Routes;
use tonic::transport::server::TcpIncoming;
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;

use crate::config::ServerConfig;
use crate::dm_env_rpc::Worlds;
use crate::error::ServerError;
use crate::services::Services;
use crate::sessions::Sessions;

/// How often idle sessions are looked for.
const REAP_PERIOD: Duration = Duration::from_secs(5);
/// How often an open connection is asked whether its client still lives.
const KEEPALIVE_PERIOD: Duration = Duration::from_secs(30);
/// HTTP/2 flow-control windows: a step of 4096 environments should not wait for credit.
const STREAM_WINDOW_BYTES: u32 = 4 << 20;
const CONNECTION_WINDOW_BYTES: u32 = 16 << 20;
/// Room for as many samples as an estimate of leakage may have.
const ARRAYS_BYTES: usize = 64 << 20;
/// A message is a little larger than the policy or the snapshot in it.
const MESSAGE_SLACK_BYTES: usize = 64 << 10;

/// Why a server could not listen or went down.
#[derive(Debug, thiserror::Error)]
pub enum TransportError {
    /// The address is taken, not ours, or malformed.
    #[error("cannot listen on {address}: {cause}{}", hint(cause))]
    Listen {
        /// The address or path.
        address: String,
        /// What the system said.
        cause: std::io::Error,
    },
    /// Simulation threads could not be started.
    #[error(transparent)]
    Server(#[from] ServerError),
    /// The transport failed.
    #[error("the server stopped: {0}")]
    Transport(#[from] tonic::transport::Error),
}

fn hint(error: &std::io::Error) -> &'static str {
    match error.kind() {
        std::io::ErrorKind::AddrInUse => {
            " (another program listens there; choose another address, or port 0 for any free one)"
        }
        _ => "",
    }
}

/// A place where clients can connect.
pub enum Listener {
    /// TCP.
    Tcp(TcpListener),
    /// A Unix socket; the file is removed when the listener is dropped.
    Unix(UnixListener, SocketFile),
    /// A connection inside this process.
    InProcess(tokio::io::DuplexStream),
}

/// A socket's file, removed in the end.
pub struct SocketFile(PathBuf);

impl Drop for SocketFile {
    fn drop(&mut self) {
        // It may be gone already.
        let _ = std::fs::remove_file(&self.0);
    }
}

impl Listener {
    /// Listens on a TCP address.
    ///
    /// # Errors
    /// [`TransportError::Listen`].
    pub async fn tcp(address: SocketAddr) -> Result<Self, TransportError> {
        TcpListener::bind(address)
            .await
            .map(Self::Tcp)
            .map_err(|cause| TransportError::Listen { address: address.to_string(), cause })
    }

    /// Listens on a Unix socket. A socket file that nobody listens on is replaced.
    ///
    /// # Errors
    /// [`TransportError::Listen`].
    pub fn unix(path: &Path) -> Result<Self, TransportError> {
        let listen = || {
            UnixListener::bind(path)
                .map(|listener| Self::Unix(listener, SocketFile(path.to_path_buf())))
        };
        let is_stale = |error: &std::io::Error| {
            use std::os::unix::fs::FileTypeExt;
            error.kind() == std::io::ErrorKind::AddrInUse
                && std::fs::symlink_metadata(path).is_ok_and(|meta| meta.file_type().is_socket())
                && std::os::unix::net::UnixStream::connect(path).is_err()
        };
        listen()
            .or_else(|error| {
                if is_stale(&error) {
                    std::fs::remove_file(path)?;
                    return listen();
                }
                Err(error)
            })
            .map_err(|cause| TransportError::Listen { address: path.display().to_string(), cause })
    }

    /// The TCP address, with the real port.
    #[must_use]
    pub fn local_address(&self) -> Option<SocketAddr> {
        match self {
            Self::Tcp(listener) => listener.local_addr().ok(),
            Self::Unix(..) | Self::InProcess(_) => None,
        }
    }
}

/// A server, ready to run.
pub struct Server {
    config: ServerConfig,
    services: Services,
}

impl Server {
    /// Starts the simulation threads.
    ///
    /// # Errors
    /// [`ServerError::Sim`] if the system has no threads to give.
    pub fn new(config: ServerConfig) -> Result<Self, ServerError> {
        let threads = SimulationThreads::start(config.simulation_threads)?;
        let services = Services {
            sessions: Arc::new(Sessions::new(config.limits, threads.clone())),
            worlds: Arc::new(Worlds::new(config.limits.max_sessions, config.limits.session_idle)),
            limits: config.limits,
            threads,
            rollouts: Arc::new(Semaphore::new(config.limits.max_rollouts)),
            draining: CancellationToken::new(),
        };
        Ok(Self { config, services })
    }

    /// Serves until `shutdown`, then drains: health says NOT_SERVING, nothing new is opened,
    /// running steps are answered, evaluations and collections end with UNAVAILABLE.
    ///
    /// # Errors
    /// [`TransportError::Transport`].
    pub async fn serve(
        self,
        listeners: Vec<Listener>,
        shutdown: impl Future<Output = ()>,
    ) -> Result<(), TransportError> {
        let (health, health_service) = tonic_health::server::health_reporter();
        report(&health, ServingStatus::Serving).await;
        let routes = self.routes()?.add_service(health_service);
        let mut servers = JoinSet::new();
        for listener in listeners {
            let draining = self.services.draining.clone();
            servers.spawn(serve_on(routes.clone(), listener, draining));
        }
        let reaper = tokio::spawn(reap(self.services.clone()));
        tokio::pin!(shutdown);
        let early_end = tokio::select! {
            () = &mut shutdown => None,
            Some(ended) = servers.join_next() => Some(ended),
        };
        tracing::info!("draining");
        report(&health, ServingStatus::NotServing).await;
        self.services.sessions.drain();
        self.services.draining.cancel();
        let drained = tokio::time::timeout(self.config.drain_timeout, async {
            while servers.join_next().await.is_some() {}
        });
        if drained.await.is_err() {
            tracing::warn!(timeout = ?self.config.drain_timeout, "connections still open; closing them");
        }
        reaper.abort();
        match early_end {
            Some(Ok(Err(error))) => Err(error.into()),
            _ => Ok(()),
        }
    }

    fn routes(&self) -> Result<Routes, ServerError> {
        let limits = &self.config.limits;
        let policy_bytes = limits.policy.max_bytes + MESSAGE_SLACK_BYTES;
        let services = || self.services.clone();
        let reflection = || {
            tonic_reflection::server::Builder::configure()
                .register_encoded_file_descriptor_set(FILE_DESCRIPTOR_SET)
                .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
        };
        let internal = |error: tonic_reflection::server::Error| {
            ServerError::Internal(format!("reflection: {error}"))
        };
        Ok(Routes::new(reflection().build_v1().map_err(internal)?)
            .add_service(reflection().build_v1alpha().map_err(internal)?)
            .add_service(
                EnvironmentServiceServer::new(services())
                    .max_decoding_message_size(limits.max_message_bytes),
            )
            .add_service(
                EvaluationServiceServer::new(services()).max_decoding_message_size(policy_bytes),
            )
            .add_service(
                CollectionServiceServer::new(services()).max_decoding_message_size(policy_bytes),
            )
            .add_service(
                LeakageServiceServer::new(services())
                    .max_decoding_message_size(policy_bytes + ARRAYS_BYTES),
            )
            .add_service(
                SnapshotServiceServer::new(services())
                    .max_decoding_message_size(limits.max_snapshot_bytes + MESSAGE_SLACK_BYTES),
            )
            .add_service(
                EnvironmentServer::new(services())
                    .max_decoding_message_size(limits.max_message_bytes),
            )
            .add_service(ServerServiceServer::new(services())))
    }
}

/// Tells health checks, service by service and for the server as a whole.
async fn report(health: &HealthReporter, status: ServingStatus) {
    let services = [
        "",
        EnvironmentServiceServer::<Services>::NAME,
        EvaluationServiceServer::<Services>::NAME,
        CollectionServiceServer::<Services>::NAME,
        LeakageServiceServer::<Services>::NAME,
        ServerServiceServer::<Services>::NAME,
        SnapshotServiceServer::<Services>::NAME,
        EnvironmentServer::<Services>::NAME,
    ];
    for service in services {
        health.set_service_status(service, status).await;
    }
}

async fn serve_on(
    routes: Routes,
    listener: Listener,
    draining: CancellationToken,
) -> Result<(), tonic::transport::Error> {
    let router = tonic::transport::Server::builder()
        .initial_stream_window_size(STREAM_WINDOW_BYTES)
        .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
        .http2_keepalive_interval(Some(KEEPALIVE_PERIOD))
        .add_routes(routes);
    let shutdown = draining.cancelled_owned();
    match listener {
        Listener::Tcp(listener) => {
            let incoming = TcpIncoming::from(listener).with_nodelay(Some(true));
            router.serve_with_incoming_shutdown(incoming, shutdown).await
        }
        Listener::Unix(listener, _file) => {
            let incoming = UnixListenerStream::new(listener);
            router.serve_with_incoming_shutdown(incoming, shutdown).await
        }
        Listener::InProcess(stream) => {
            // The end of the incoming connections would be taken for the end of the server.
            let only = tokio_stream::once(Ok::<_, std::io::Error>(stream));
            let incoming = only.chain(tokio_stream::pending());
            router.serve_with_incoming_shutdown(incoming, shutdown).await
        }
    }
}

async fn reap(services: Services) {
    let mut period = tokio::time::interval(REAP_PERIOD);
    loop {
        period.tick().await;
        let (sessions, worlds) = (services.sessions.reap(), services.worlds.reap());
        if sessions + worlds > 0 {
            tracing::info!(sessions, worlds, "idle ones closed");
        }
    }
}
