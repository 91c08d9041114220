//! Connections and plain calls.

use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use hyper_util::rt::TokioIo;
use palr_gym_proto::v1;
use palr_gym_proto::v1::collection_service_client::CollectionServiceClient;
use palr_gym_proto::v1::environment_service_client::EnvironmentServiceClient;
use palr_gym_proto::v1::evaluation_service_client::EvaluationServiceClient;
use palr_gym_proto::v1::leakage_service_client::LeakageServiceClient;
use palr_gym_proto::v1::render_service_client::RenderServiceClient;
use palr_gym_proto::v1::server_service_client::ServerServiceClient;
use palr_gym_proto::v1::snapshot_service_client::SnapshotServiceClient;
use tokio::net::UnixStream;
use tonic::transport::{Channel, Endpoint, Uri};

use crate::error::ClientError;

/// Where a server listens.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ServerAddress {
    /// `HOST:PORT`.
    Tcp(String),
    /// `unix:PATH`.
    Unix(PathBuf),
}

impl FromStr for ServerAddress {
    type Err = ClientError;

    fn from_str(text: &str) -> Result<Self, ClientError> {
        if let Some(path) = text.strip_prefix("unix:").filter(|path| !path.is_empty()) {
            return Ok(Self::Unix(path.into()));
        }
        let plain = text.strip_prefix("http://").unwrap_or(text);
        match plain.rsplit_once(':') {
            Some((host, port)) if !host.is_empty() && port.parse::<u16>().is_ok() => {
                Ok(Self::Tcp(plain.to_owned()))
            }
            _ => Err(ClientError::Address { address: text.to_owned() }),
        }
    }
}

impl std::fmt::Display for ServerAddress {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Tcp(address) => formatter.write_str(address),
            Self::Unix(path) => write!(formatter, "unix:{}", path.display()),
        }
    }
}

/// A connection to a server. Clones share it.
#[derive(Debug, Clone)]
pub struct Client {
    channel: Channel,
    deadline: Duration,
}

/// How long a client waits for a sign of life when nobody says otherwise.
pub const DEFAULT_DEADLINE: Duration = Duration::from_secs(120);

const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
const WINDOW_BYTES: u32 = 16 << 20;

/// What an endpoint of ours looks like, wherever it leads.
#[must_use]
pub fn tuned(endpoint: Endpoint) -> Endpoint {
    endpoint
        .connect_timeout(CONNECT_TIMEOUT)
        .tcp_nodelay(true)
        .initial_stream_window_size(WINDOW_BYTES)
        .initial_connection_window_size(WINDOW_BYTES)
        // A server that vanishes without a word is noticed.
        .http2_keep_alive_interval(Duration::from_secs(20))
        .keep_alive_timeout(Duration::from_secs(20))
}

impl Client {
    /// Connects to `address`.
    ///
    /// # Errors
    /// [`ClientError::Unreachable`] within five seconds.
    pub async fn connect(address: &ServerAddress) -> Result<Self, ClientError> {
        let unreachable = |error: tonic::transport::Error| {
            use std::error::Error;
            let mut message = error.to_string();
            let mut cause = error.source();
            while let Some(error) = cause {
                message = error.to_string();
                cause = error.source();
            }
            ClientError::Unreachable { address: address.to_string(), message }
        };
        let channel = match address {
            ServerAddress::Tcp(address) => {
                let endpoint =
                    Endpoint::from_shared(format!("http://{address}")).map_err(unreachable)?;
                tuned(endpoint).connect().await
            }
            ServerAddress::Unix(path) => {
                let path = path.clone();
                let connector = tower::service_fn(move |_: Uri| {
                    let path = path.clone();
                    async move { UnixStream::connect(path).await.map(TokioIo::new) }
                });
                tuned(Endpoint::from_static("http://localhost"))
                    .connect_with_connector(connector)
                    .await
            }
        };
        channel.map(Self::from_channel).map_err(unreachable)
    }

    /// Uses a connection that somebody else made.
    #[must_use]
    pub fn from_channel(channel: Channel) -> Self {
        Self { channel, deadline: DEFAULT_DEADLINE }
    }

    /// The same connection, on which no call waits longer than `deadline` for its answer, and no
    /// stream for its next message.
    #[must_use]
    pub fn with_deadline(self, deadline: Duration) -> Self {
        Self { deadline, ..self }
    }

    /// Waits for `answer`, but not longer than the deadline.
    pub(crate) async fn within<T>(
        &self,
        answer: impl Future<Output = Result<T, tonic::Status>>,
    ) -> Result<T, ClientError> {
        match tokio::time::timeout(self.deadline, answer).await {
            Ok(answer) => Ok(answer?),
            Err(_) => Err(ClientError::Status {
                code: tonic::Code::DeadlineExceeded,
                reason: None,
                message: format!("the server said nothing for {:?}", self.deadline),
            }),
        }
    }

    /// Versions and limits.
    ///
    /// # Errors
    /// [`ClientError::Status`].
    pub async fn server_info(&self) -> Result<v1::GetServerInfoResponse, ClientError> {
        let mut service = ServerServiceClient::new(self.channel.clone());
        let answer = self.within(service.get_server_info(v1::GetServerInfoRequest {})).await?;
        Ok(answer.into_inner())
    }

    /// Every task.
    ///
    /// # Errors
    /// [`ClientError::Status`].
    pub async fn tasks(&self) -> Result<Vec<v1::Task>, ClientError> {
        let mut service = self.environments();
        let response = self.within(service.list_tasks(v1::ListTasksRequest {})).await?;
        Ok(response.into_inner().tasks)
    }

    /// What an id such as `hopper-w2` stands for.
    ///
    /// # Errors
    /// [`ClientError::Status`].
    pub async fn spec(&self, env_id: &str) -> Result<v1::EnvironmentSpec, ClientError> {
        let request = v1::GetEnvironmentSpecRequest { env_id: env_id.to_owned() };
        let mut service = self.environments();
        let response = self.within(service.get_environment_spec(request)).await?;
        response
            .into_inner()
            .spec
            .ok_or_else(|| ClientError::Protocol("no spec in the answer".into()))
    }

    // Answers may be as large as environments times stacks make them; the server bounds both.

    pub(crate) fn environments(&self) -> EnvironmentServiceClient<Channel> {
        EnvironmentServiceClient::new(self.channel.clone()).max_decoding_message_size(usize::MAX)
    }

    pub(crate) fn evaluations(&self) -> EvaluationServiceClient<Channel> {
        EvaluationServiceClient::new(self.channel.clone()).max_decoding_message_size(usize::MAX)
    }

    pub(crate) fn leakages(&self) -> LeakageServiceClient<Channel> {
        LeakageServiceClient::new(self.channel.clone()).max_decoding_message_size(usize::MAX)
    }

    pub(crate) fn snapshots(&self) -> SnapshotServiceClient<Channel> {
        SnapshotServiceClient::new(self.channel.clone()).max_decoding_message_size(usize::MAX)
    }

    pub(crate) fn renders(&self) -> RenderServiceClient<Channel> {
        RenderServiceClient::new(self.channel.clone()).max_decoding_message_size(usize::MAX)
    }

    pub(crate) fn collections(&self) -> CollectionServiceClient<Channel> {
        CollectionServiceClient::new(self.channel.clone()).max_decoding_message_size(usize::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_a_host_with_a_port_or_a_socket_path() {
        let parse = |text: &str| text.parse::<ServerAddress>().map(|address| address.to_string());
        assert_eq!(parse("localhost:7257").unwrap(), "localhost:7257");
        assert_eq!(parse("http://[::1]:80").unwrap(), "[::1]:80");
        assert_eq!(parse("unix:/tmp/x.sock").unwrap(), "unix:/tmp/x.sock");
        for wrong in ["", "localhost", "localhost:99999", ":80", "unix:"] {
            let error = parse(wrong).unwrap_err();
            assert!(error.to_string().contains("expected HOST:PORT or unix:PATH"), "{error}");
        }
    }
}
