//! A session of environments, stepped over a stream.

use bytes::Bytes;
use palr_gym_proto::v1;
use palr_gym_proto::v1::step_stream_request::Request;
use palr_gym_proto::v1::step_stream_response::Response;
use tokio::sync::mpsc;
use tokio_stream::wrappers::UnboundedReceiverStream;
use tonic::{Code, Streaming};

use crate::client::Client;
use crate::error::ClientError;

/// N environments on a server. Dropping it leaves the session to the server's idle limit;
/// [`close`](Self::close) frees it at once.
pub struct Session {
    client: Client,
    session_id: String,
    spec: v1::EnvironmentSpec,
    num_envs: usize,
    requests: mpsc::UnboundedSender<v1::StepStreamRequest>,
    answers: Streaming<v1::StepStreamResponse>,
}

impl Session {
    /// Opens a session and its stream. No call waits longer than the client's deadline.
    ///
    /// # Errors
    /// [`ClientError::Status`].
    pub async fn open(
        client: &Client,
        request: v1::OpenSessionRequest,
    ) -> Result<Self, ClientError> {
        let mut service = client.environments();
        let opened = client.within(service.open_session(request)).await?.into_inner();
        Self::from_opened(client, opened).await
    }

    /// Opens a session in the state of a snapshot, of this server or another one.
    ///
    /// # Errors
    /// [`ClientError::Status`].
    pub async fn from_snapshot(
        client: &Client,
        snapshot: Bytes,
    ) -> Result<(Self, v1::RestoredState), ClientError> {
        let request = v1::OpenSnapshotRequest { snapshot };
        let mut service = client.snapshots();
        let answer = client.within(service.open_snapshot(request)).await?.into_inner();
        let session = answer.session.ok_or_else(|| missing("session"))?;
        let state = answer.state.ok_or_else(|| missing("state"))?;
        Ok((Self::from_opened(client, session).await?, state))
    }

    async fn from_opened(
        client: &Client,
        opened: v1::OpenSessionResponse,
    ) -> Result<Self, ClientError> {
        let mut service = client.environments();
        let (requests, outgoing) = mpsc::unbounded_channel();
        let outgoing = UnboundedReceiverStream::new(outgoing);
        let answers = client.within(service.step_stream(outgoing)).await?.into_inner();
        Ok(Self {
            client: client.clone(),
            session_id: opened.session_id,
            spec: opened.spec.ok_or_else(|| missing("spec"))?,
            num_envs: opened.num_envs as usize,
            requests,
            answers,
        })
    }

    /// What the environments are.
    #[must_use]
    pub fn spec(&self) -> &v1::EnvironmentSpec {
        &self.spec
    }

    /// Its name on the server.
    #[must_use]
    pub fn id(&self) -> &str {
        &self.session_id
    }

    /// Number of environments.
    #[must_use]
    pub fn num_envs(&self) -> usize {
        self.num_envs
    }

    /// Starts new episodes; see the protocol for `seeds`.
    ///
    /// # Errors
    /// [`ClientError::Status`].
    pub async fn reset(&mut self, seeds: Vec<u64>) -> Result<v1::ResetResponse, ClientError> {
        self.reset_envs(vec![], seeds).await
    }

    /// Starts new episodes in the environments of `env_indices`, ascending; none: in all of them.
    ///
    /// # Errors
    /// [`ClientError::Status`].
    pub async fn reset_envs(
        &mut self,
        env_indices: Vec<u32>,
        seeds: Vec<u64>,
    ) -> Result<v1::ResetResponse, ClientError> {
        let session_id = self.session_id.clone();
        self.send(Request::Reset(v1::ResetRequest { session_id, seeds, env_indices }))?;
        match self.receive().await? {
            Response::Reset(answer) => Ok(answer),
            _ => Err(ClientError::Protocol("no answer to a reset".into())),
        }
    }

    /// Steps every environment with its row of `actions`, `[num_envs, action size]`.
    ///
    /// # Errors
    /// [`ClientError::Status`].
    pub async fn step(&mut self, actions: &[f32]) -> Result<v1::StepResponse, ClientError> {
        self.send_step(actions)?;
        self.receive_step().await
    }

    /// Sends actions without waiting for what comes of them: see
    /// [`receive_step`](Self::receive_step).
    ///
    /// # Errors
    /// [`ClientError::Status`] if the stream is gone.
    pub fn send_step(&mut self, actions: &[f32]) -> Result<(), ClientError> {
        let shape = vec![self.num_envs as i64, (actions.len() / self.num_envs) as i64];
        self.send_actions(actions, shape)
    }

    /// Takes `steps` steps in one go (open loop), the k-th with row k of `actions`,
    /// `[steps, num_envs, action size]`. The arrays of the answer begin with a dimension of steps.
    ///
    /// # Errors
    /// [`ClientError::Status`].
    pub async fn step_open_loop(
        &mut self,
        actions: &[f32],
        steps: usize,
    ) -> Result<v1::StepResponse, ClientError> {
        let rows = steps * self.num_envs;
        let columns = actions.len() / rows.max(1);
        self.send_actions(actions, vec![steps as i64, self.num_envs as i64, columns as i64])?;
        self.receive_step().await
    }

    fn send_actions(&mut self, actions: &[f32], shape: Vec<i64>) -> Result<(), ClientError> {
        let actions = v1::Tensor {
            dtype: v1::DataType::Float32.into(),
            shape,
            data: Bytes::copy_from_slice(bytemuck::cast_slice(actions)),
        };
        let session_id = self.session_id.clone();
        self.send(Request::Step(v1::StepRequest { session_id, actions: Some(actions) }))
    }

    /// The session's state, for [`restore`](Self::restore) and
    /// [`from_snapshot`](Self::from_snapshot). Requests without an answer yet may come before it or
    /// after.
    ///
    /// # Errors
    /// [`ClientError::Status`].
    pub async fn snapshot(&self) -> Result<Bytes, ClientError> {
        let request = v1::TakeSnapshotRequest { session_id: self.session_id.clone() };
        let mut service = self.client.snapshots();
        Ok(self.client.within(service.take_snapshot(request)).await?.into_inner().snapshot)
    }

    /// Puts the session into the state of a snapshot.
    ///
    /// # Errors
    /// [`ClientError::Status`].
    pub async fn restore(&mut self, snapshot: Bytes) -> Result<v1::RestoredState, ClientError> {
        let session_id = self.session_id.clone();
        let request = v1::RestoreSnapshotRequest { session_id, snapshot };
        let mut service = self.client.snapshots();
        let answer = self.client.within(service.restore_snapshot(request)).await?.into_inner();
        answer.state.ok_or_else(|| missing("state"))
    }

    /// A new session that goes on from where this one stands.
    ///
    /// # Errors
    /// [`ClientError::Status`].
    pub async fn fork(&self) -> Result<(Self, v1::RestoredState), ClientError> {
        let request = v1::ForkSessionRequest { session_id: self.session_id.clone() };
        let mut service = self.client.snapshots();
        let answer = self.client.within(service.fork_session(request)).await?.into_inner();
        let session = answer.session.ok_or_else(|| missing("session"))?;
        let state = answer.state.ok_or_else(|| missing("state"))?;
        Ok((Self::from_opened(&self.client, session).await?, state))
    }

    /// The answer to the oldest step that has none yet.
    ///
    /// # Errors
    /// [`ClientError::Status`].
    pub async fn receive_step(&mut self) -> Result<v1::StepResponse, ClientError> {
        match self.receive().await? {
            Response::Step(answer) => Ok(answer),
            _ => Err(ClientError::Protocol("no answer to a step".into())),
        }
    }

    fn send(&mut self, request: Request) -> Result<(), ClientError> {
        let request = v1::StepStreamRequest { request: Some(request) };
        self.requests.send(request).map_err(|_| stream_ended())
    }

    async fn receive(&mut self) -> Result<Response, ClientError> {
        let answer = self.client.within(self.answers.message()).await?.ok_or_else(stream_ended)?;
        match answer.response {
            Some(Response::Error(status)) => {
                let code = Code::from_i32(status.code);
                let details = prost::Message::encode_to_vec(&status).into();
                Err(tonic::Status::with_details(code, status.message, details).into())
            }
            Some(answer) => Ok(answer),
            None => Err(ClientError::Protocol("an empty answer".into())),
        }
    }

    /// Closes the session.
    ///
    /// # Errors
    /// [`ClientError::Status`].
    pub async fn close(self) -> Result<(), ClientError> {
        let request = v1::CloseSessionRequest { session_id: self.session_id };
        let mut service = self.client.environments();
        self.client.within(service.close_session(request)).await?;
        Ok(())
    }
}

fn missing(what: &str) -> ClientError {
    ClientError::Protocol(format!("no {what} in the answer"))
}

fn stream_ended() -> ClientError {
    ClientError::Status {
        code: Code::Unavailable,
        reason: None,
        message: "the server ended the stream".into(),
    }
}
