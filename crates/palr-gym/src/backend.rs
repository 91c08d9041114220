//! A server to talk to: the user's, or one inside this process.

use std::time::Duration;

use hyper_util::rt::TokioIo;
use palr_gym_server::{Listener, Server, ServerConfig};
use palr_gym_sim::render::GlChoice;
use palr_gym_trainer::Client;
use palr_gym_trainer::client::tuned;
use tonic::transport::{Endpoint, Uri};

use crate::cli::ServerArguments;

/// Bytes in flight between client and server of one process.
const PIPE_BYTES: usize = 1 << 20;

/// Connects to the server that was named, or starts one in this process and connects to that. Either way the client
/// speaks gRPC.
pub async fn connect(arguments: &ServerArguments) -> anyhow::Result<Client> {
    connect_drawing(arguments, GlChoice::default()).await
}

/// The same; a server in this process draws with `gl`.
pub async fn connect_drawing(arguments: &ServerArguments, gl: GlChoice) -> anyhow::Result<Client> {
    let client = match &arguments.server {
        Some(address) => Client::connect(address).await?,
        None => start_in_process(gl).await?,
    };
    Ok(client.with_deadline(Duration::from_secs(arguments.deadline)))
}

async fn start_in_process(gl: GlChoice) -> anyhow::Result<Client> {
    let (ours, theirs) = tokio::io::duplex(PIPE_BYTES);
    let server = Server::new(ServerConfig { gl, ..ServerConfig::default() })?;
    tokio::spawn(server.serve(vec![Listener::InProcess(theirs)], std::future::pending()));
    let mut ours = Some(TokioIo::new(ours));
    let connector = tower::service_fn(move |_: Uri| {
        let ours =
            ours.take().ok_or_else(|| std::io::Error::other("the server in this process stopped"));
        async move { ours }
    });
    let endpoint = tuned(Endpoint::from_static("http://in-process"));
    Ok(Client::from_channel(endpoint.connect_with_connector(connector).await?))
}
