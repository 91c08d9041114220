//! A server to talk to.

use std::future::Future;
use std::path::PathBuf;
use std::time::Duration;

use bytes::Bytes;
use palr_gym_proto::v1;
use palr_gym_server::{Listener, Server, ServerConfig};
use palr_gym_trainer::{Client, ServerAddress};
use tempfile::TempDir;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tonic::transport::{Channel, Endpoint};

/// A server on a TCP port and a Unix socket of its own.
pub struct TestServer {
    pub tcp: ServerAddress,
    pub unix: ServerAddress,
    stop: Option<oneshot::Sender<()>>,
    running: JoinHandle<bool>,
    _folder: TempDir,
    _leaving: Leaving,
}

/// Once it is gone, threads that drew leave their OpenGL contexts to the system, as in the program: one
/// that frees its own while the test's process exits crashes.
struct Leaving;

impl Drop for Leaving {
    fn drop(&mut self) {
        palr_gym_sim::threads::before_exit();
    }
}

impl TestServer {
    pub async fn start(config: ServerConfig) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path: PathBuf = folder.path().join("socket");
        let tcp = Listener::tcp("127.0.0.1:0".parse().unwrap()).await.unwrap();
        let address = tcp.local_address().unwrap();
        let listeners = vec![tcp, Listener::unix(&path).unwrap()];
        let server = Server::new(config).unwrap();
        let (stop, stopped) = oneshot::channel();
        let running = tokio::spawn(async move {
            let shutdown = async { drop(stopped.await) };
            server.serve(listeners, shutdown).await.is_ok()
        });
        Self {
            tcp: ServerAddress::Tcp(address.to_string()),
            unix: ServerAddress::Unix(path),
            stop: Some(stop),
            running,
            _folder: folder,
            _leaving: Leaving,
        }
    }

    pub async fn with_defaults() -> Self {
        Self::start(ServerConfig { simulation_threads: 2, ..ServerConfig::default() }).await
    }

    pub async fn client(&self) -> Client {
        Client::connect(&self.unix).await.unwrap()
    }

    pub async fn channel(&self) -> Channel {
        Endpoint::from_shared(format!("http://{}", self.tcp)).unwrap().connect().await.unwrap()
    }

    /// Asks the server to stop.
    pub fn stop(&mut self) {
        drop(self.stop.take());
    }

    /// True if the server ended without an error.
    pub async fn ended(self) -> bool {
        soon(self.running).await.unwrap()
    }
}

/// Fails the test instead of hanging it.
pub async fn soon<T>(future: impl Future<Output = T>) -> T {
    tokio::time::timeout(Duration::from_secs(20), future).await.expect("nothing happened in 20 s")
}

pub fn open(env_id: &str, num_envs: u32) -> v1::OpenSessionRequest {
    v1::OpenSessionRequest {
        env_id: env_id.into(),
        num_envs: Some(num_envs),
        ..v1::OpenSessionRequest::default()
    }
}

pub fn float32(values: &[f32], shape: &[i64]) -> v1::Tensor {
    v1::Tensor {
        dtype: v1::DataType::Float32.into(),
        shape: shape.to_vec(),
        data: Bytes::copy_from_slice(bytemuck::cast_slice(values)),
    }
}

pub fn random() -> v1::Policy {
    v1::Policy { policy: Some(v1::policy::Policy::Random(v1::RandomPolicy {})) }
}

pub fn expert() -> v1::Policy {
    v1::Policy { policy: Some(v1::policy::Policy::Expert(v1::ExpertPolicy {})) }
}
