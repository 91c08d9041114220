//! `EnvironmentService`.

use std::pin::Pin;
use std::sync::Arc;

use futures_util::{FutureExt, Stream, StreamExt, future};
use palr_gym_core::EnvSpec;
use palr_gym_proto::v1;
use palr_gym_proto::v1::environment_service_server::EnvironmentService;
use palr_gym_proto::v1::step_stream_request::Request as StreamRequest;
use palr_gym_proto::v1::step_stream_response::Response as StreamResponse;
use palr_gym_sim::VectorOptions;
use palr_gym_sim::tasks::TASKS;
use tonic::{Request, Response, Status, Streaming, async_trait};

use super::Services;
use crate::config::Limits;
use crate::convert;
use crate::encode::{WireAnswer, WireEncode};
use crate::error::ServerError;
use crate::session::{Command, Promise, Session};
use crate::status::in_band;

pub(super) type WireSession = Arc<Session<WireEncode>>;

/// What came of queuing a request.
pub(super) type Queued = Result<Promise<WireAnswer>, ServerError>;

#[async_trait]
impl EnvironmentService for Services {
    async fn list_tasks(
        &self,
        _: Request<v1::ListTasksRequest>,
    ) -> Result<Response<v1::ListTasksResponse>, Status> {
        let tasks = TASKS.iter().map(|task| convert::task(*task)).collect();
        Ok(Response::new(v1::ListTasksResponse { tasks }))
    }

    async fn get_environment_spec(
        &self,
        request: Request<v1::GetEnvironmentSpecRequest>,
    ) -> Result<Response<v1::GetEnvironmentSpecResponse>, Status> {
        let (vision, env_id) = (Arc::clone(&self.vision), request.into_inner().env_id);
        // An extractor may have to be loaded.
        let resolved = tokio::task::spawn_blocking(move || vision.resolve(&env_id, None));
        let (_, spec, _) =
            resolved.await.map_err(|error| ServerError::Internal(error.to_string()))??;
        let spec = Some(self.spec(&spec, WireEncode::default()));
        Ok(Response::new(v1::GetEnvironmentSpecResponse { spec }))
    }

    async fn open_session(
        &self,
        request: Request<v1::OpenSessionRequest>,
    ) -> Result<Response<v1::OpenSessionResponse>, Status> {
        let request = request.into_inner();
        let options = VectorOptions {
            autoreset_mode: convert::autoreset_mode(request.autoreset_mode)?,
            out_of_bounds: convert::out_of_bounds(request.out_of_bounds)?,
        };
        let scene = request.scene_options.map(convert::scene_options).transpose()?;
        let observation_type = convert::observation_type(request.observation_dtype)?;
        let sessions = Arc::clone(&self.sessions);
        let opened = tokio::task::spawn_blocking(move || {
            let num_envs = u64::from(request.num_envs.unwrap_or(1));
            let encode = WireEncode { observation_type };
            sessions.open(&request.env_id, scene, num_envs, options, encode)
        });
        let session = opened.await.map_err(|error| ServerError::Internal(error.to_string()))??;
        tracing::info!(
            session_id = %session.id(),
            env_id = %session.spec().env_id,
            num_envs = session.num_envs(),
            "session opened"
        );
        Ok(Response::new(self.opened(&session)))
    }

    async fn close_session(
        &self,
        request: Request<v1::CloseSessionRequest>,
    ) -> Result<Response<v1::CloseSessionResponse>, Status> {
        let session_id = &request.get_ref().session_id;
        self.sessions.close(session_id)?;
        tracing::info!(session_id, "session closed");
        Ok(Response::new(v1::CloseSessionResponse {}))
    }

    async fn reset(
        &self,
        request: Request<v1::ResetRequest>,
    ) -> Result<Response<v1::ResetResponse>, Status> {
        let request = request.into_inner();
        let session = self.sessions.get(&request.session_id)?;
        match keep(queue_reset(&session, request)).await? {
            WireAnswer::Reset(answer) => Ok(Response::new(answer)),
            _ => Err(mismatch().into()),
        }
    }

    async fn step(
        &self,
        request: Request<v1::StepRequest>,
    ) -> Result<Response<v1::StepResponse>, Status> {
        let request = request.into_inner();
        let session = self.sessions.get(&request.session_id)?;
        match keep(self.queue_step(&session, &request)).await? {
            WireAnswer::Step(answer) => Ok(Response::new(*answer)),
            _ => Err(mismatch().into()),
        }
    }

    type StepStreamStream =
        Pin<Box<dyn Stream<Item = Result<v1::StepStreamResponse, Status>> + Send>>;

    /// Requests are queued as they are read, and answers awaited in order; no more than
    /// `max_pipelined_requests` are under way, so a client that does not read stops being read.
    async fn step_stream(
        &self,
        request: Request<Streaming<v1::StepStreamRequest>>,
    ) -> Result<Response<Self::StepStreamStream>, Status> {
        let services = self.clone();
        let draining = self.draining.clone();
        let mut last: Option<WireSession> = None;
        let answers = request
            .into_inner()
            // What cannot be read (a message beyond the size limit) ends the stream, with the reason.
            .scan(false, |is_broken, request| {
                let is_last = std::mem::replace(is_broken, request.is_err());
                future::ready((!is_last).then_some(request))
            })
            .take_until(draining.cancelled_owned())
            .map(move |request| match request {
                Ok(request) => {
                    let queued = services.queue_streamed(request, &mut last);
                    keep(queued).map(|answer| Ok(stream_response(answer))).left_future()
                }
                Err(status) => future::ready(Err(status)).right_future(),
            })
            .buffered(self.limits.max_pipelined_requests);
        Ok(Response::new(Box::pin(answers)))
    }
}

impl Services {
    /// What a client is told of a session that was opened.
    pub(super) fn opened(&self, session: &WireSession) -> v1::OpenSessionResponse {
        v1::OpenSessionResponse {
            session_id: session.id().to_string(),
            spec: Some(self.spec(session.spec(), *session.encode())),
            num_envs: session.num_envs() as u32,
            idle_limit_s: self.limits.session_idle.as_secs() as u32,
        }
    }

    /// What a client is told of an environment.
    pub(super) fn spec(&self, spec: &EnvSpec, encode: WireEncode) -> v1::EnvironmentSpec {
        let extractor = self.vision.extractor_of(spec).map(convert::feature_extractor);
        v1::EnvironmentSpec {
            feature_extractor: extractor,
            ..convert::environment_spec(spec, encode.observation_dtype(spec))
        }
    }

    fn queue_step(&self, session: &WireSession, request: &v1::StepRequest) -> Queued {
        let (num_envs, spec) = (session.num_envs(), session.spec());
        let actions = convert::actions(request.actions.as_ref(), num_envs, spec.action_size())?;
        let Some(steps) = actions.open_loop else {
            return session.submit(Command::Step { actions: actions.values });
        };
        let step_bytes = session.encode().step_bytes(spec, num_envs);
        let answer_bytes = step_bytes.saturating_mul(steps);
        let Limits { max_open_loop_steps: max_steps, max_answer_bytes, .. } = self.limits;
        // A single step is as large as the session is, which was judged when it was opened.
        if steps > max_steps || (steps > 1 && answer_bytes > max_answer_bytes) {
            return Err(ServerError::OpenLoop { steps, answer_bytes, max_steps, max_answer_bytes });
        }
        session.submit(Command::OpenLoop { actions: actions.values, steps })
    }

    fn queue_streamed(
        &self,
        request: v1::StepStreamRequest,
        last: &mut Option<WireSession>,
    ) -> Queued {
        let request = request
            .request
            .ok_or(ServerError::Missing { field: "request", want: "reset or step" })?;
        let session_id = match &request {
            StreamRequest::Reset(reset) => &reset.session_id,
            StreamRequest::Step(step) => &step.session_id,
        };
        let session = self.session_of(session_id, last)?;
        match request {
            StreamRequest::Reset(reset) => queue_reset(&session, reset),
            StreamRequest::Step(step) => self.queue_step(&session, &step),
        }
    }

    /// The session that a streamed request names, or the one of the request before.
    fn session_of(
        &self,
        session_id: &str,
        last: &mut Option<WireSession>,
    ) -> Result<WireSession, ServerError> {
        if session_id.is_empty() {
            return last.clone().ok_or(ServerError::Missing {
                field: "session_id",
                want: "the id of an open session in the first request of a stream",
            });
        }
        // Looked up each time: a session may have been closed meanwhile.
        let session = self.sessions.get(session_id)?;
        *last = Some(Arc::clone(&session));
        Ok(session)
    }
}

fn queue_reset(session: &WireSession, request: v1::ResetRequest) -> Queued {
    let env_indices = request.env_indices.iter().map(|&index| index as usize).collect();
    session.submit(Command::Reset { seeds: request.seeds, env_indices })
}

/// Waits for what a queued request comes to.
pub(super) async fn keep(queued: Queued) -> Result<WireAnswer, ServerError> {
    // A promise is broken only if the session's thread died; the session then knows.
    queued?.await.map_err(|_| ServerError::Internal("a session dropped a request".into()))?
}

pub(super) fn mismatch() -> ServerError {
    ServerError::Internal("a session answered another request than the one it got".into())
}

fn stream_response(answer: Result<WireAnswer, ServerError>) -> v1::StepStreamResponse {
    let response = match answer {
        Ok(WireAnswer::Reset(reset)) => StreamResponse::Reset(reset),
        Ok(WireAnswer::Step(step)) => StreamResponse::Step(*step),
        Ok(WireAnswer::Pictures(_) | WireAnswer::Snapshot(_) | WireAnswer::Restored(_)) => {
            StreamResponse::Error(in_band(&mismatch().into()))
        }
        Err(error) => StreamResponse::Error(in_band(&error.into())),
    };
    v1::StepStreamResponse { response: Some(response) }
}
