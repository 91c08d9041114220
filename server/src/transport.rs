//! Listening, health, reflection, draining.

mod connection;

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use palr_gym_proto::FILE_DESCRIPTOR_SET;
use palr_gym_proto::dm_env_rpc::v1::environment_server::EnvironmentServer;
use palr_gym_proto::v1::collection_service_server::CollectionServiceServer;
use palr_gym_proto::v1::environment_service_server::EnvironmentServiceServer;
use palr_gym_proto::v1::evaluation_service_server::EvaluationServiceServer;
use palr_gym_proto::v1::leakage_service_server::LeakageServiceServer;
use palr_gym_proto::v1::render_service_server::RenderServiceServer;
use palr_gym_proto::v1::server_service_server::ServerServiceServer;
use palr_gym_proto::v1::snapshot_service_server::SnapshotServiceServer;
use palr_gym_sim::SimulationThreads;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, UnixListener};
use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tokio_stream::wrappers::UnixListenerStream;
use tokio_stream::{Stream, StreamExt};
use tokio_util::sync::CancellationToken;
use tonic::server::NamedService;
use tonic::service::Routes;
use tonic::transport::server::TcpIncoming;
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;

use self::connection::Admissions;
use crate::config::ServerConfig;
use crate::dm_env_rpc::Worlds;
use crate::error::ServerError;
use crate::services::Services;
use crate::services::guard::GuardLayer;
use crate::sessions::Sessions;
use crate::vision::Vision;

/// How often idle sessions are looked for.
const REAP_PERIOD: Duration = Duration::from_secs(5);
/// How often an open connection is asked whether its client still lives.
const KEEPALIVE_PERIOD: Duration = Duration::from_secs(30);
/// How long its client may take to answer that.
const KEEPALIVE_TIMEOUT: Duration = Duration::from_secs(20);
/// Calls and streams on one connection.
const MAX_STREAMS: u32 = 256;
/// Headers of one call.
const MAX_HEADER_BYTES: u32 = 16 << 10;
/// When everything has been computed, a shutdown waits this long for clients to read it.
const READING_TIME: Duration = Duration::from_secs(2);
/// How often a shutdown looks whether something is still being computed.
const DRAIN_LOOK: Duration = Duration::from_millis(50);
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
        let vision = Arc::new(Vision::new(config.gl, config.extractor.clone()));
        let services = Services {
            sessions: Arc::new(Sessions::new(config.limits, threads.clone(), Arc::clone(&vision))),
            worlds: Arc::new(Worlds::new(config.limits.max_sessions, config.limits.session_idle)),
            limits: config.limits,
            gl: config.gl,
            vision,
            threads,
            rollouts_at_work: Arc::default(),
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
        let limits = &self.config.limits;
        let hang_up = CancellationToken::new();
        let face = Face {
            routes,
            guard: GuardLayer::new(limits.max_arriving_bytes, limits.message_deadline),
            admissions: Admissions::new(limits.max_connections, hang_up.clone()),
            draining: self.services.draining.clone(),
        };
        let mut servers = JoinSet::new();
        for listener in listeners {
            servers.spawn(face.clone().serve_on(listener));
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
        let is_drained = tokio::select! {
            () = async { while servers.join_next().await.is_some() {} } => true,
            () = tokio::time::sleep(self.config.drain_timeout) => false,
            () = unread(&self.services) => false,
        };
        if !is_drained {
            tracing::warn!(
                "clients do not read their answers or do not hang up; closing their connections"
            );
        }
        hang_up.cancel();
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
                RenderServiceServer::new(services())
                    .max_decoding_message_size(limits.max_message_bytes),
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
        RenderServiceServer::<Services>::NAME,
        ServerServiceServer::<Services>::NAME,
        SnapshotServiceServer::<Services>::NAME,
        EnvironmentServer::<Services>::NAME,
    ];
    for service in services {
        health.set_service_status(service, status).await;
    }
}

/// Returns when everything has been computed and clients have had time to read it.
async fn unread(services: &Services) {
    let mut finished = Instant::now();
    while finished.elapsed() < READING_TIME {
        tokio::time::sleep(DRAIN_LOOK).await;
        if services.is_at_work() {
            finished = Instant::now();
        }
    }
}

/// What every listener shows.
#[derive(Clone)]
struct Face {
    routes: Routes,
    guard: GuardLayer,
    admissions: Admissions,
    draining: CancellationToken,
}

impl Face {
    async fn serve_on(self, listener: Listener) -> Result<(), tonic::transport::Error> {
        match listener {
            Listener::Tcp(listener) => {
                self.serve(TcpIncoming::from(listener).with_nodelay(Some(true))).await
            }
            Listener::Unix(listener, _file) => self.serve(UnixListenerStream::new(listener)).await,
            Listener::InProcess(stream) => {
                // The end of the incoming connections would be taken for the end of the server.
                let only = tokio_stream::once(Ok::<_, std::io::Error>(stream));
                self.serve(only.chain(tokio_stream::pending())).await
            }
        }
    }

    async fn serve<IO>(
        self,
        incoming: impl Stream<Item = std::io::Result<IO>> + Send,
    ) -> Result<(), tonic::transport::Error>
    where
        IO: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    {
        tonic::transport::Server::builder()
            .initial_stream_window_size(STREAM_WINDOW_BYTES)
            .initial_connection_window_size(CONNECTION_WINDOW_BYTES)
            .max_concurrent_streams(MAX_STREAMS)
            .http2_max_header_list_size(MAX_HEADER_BYTES)
            .http2_keepalive_interval(Some(KEEPALIVE_PERIOD))
            .http2_keepalive_timeout(Some(KEEPALIVE_TIMEOUT))
            .layer(self.guard)
            .add_routes(self.routes)
            .serve_with_incoming_shutdown(
                self.admissions.admit(incoming),
                self.draining.cancelled_owned(),
            )
            .await
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
