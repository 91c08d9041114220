//! `dm_env_rpc.v1.Environment`.

use std::pin::Pin;
use std::sync::Arc;

use futures_util::{Stream, StreamExt, future, stream};
use palr_gym_proto::dm_env_rpc::v1::environment_response::Payload;
use palr_gym_proto::dm_env_rpc::v1::environment_server::Environment;
use palr_gym_proto::dm_env_rpc::v1::{EnvironmentRequest, EnvironmentResponse};
use tonic::{Request, Response, Status, Streaming, async_trait};

use super::Services;
use crate::dm_env_rpc::{Connection, SessionStage};
use crate::error::ServerError;
use crate::status::in_band;

#[async_trait]
impl Environment for Services {
    type ProcessStream = Pin<Box<dyn Stream<Item = Result<EnvironmentResponse, Status>> + Send>>;

    /// One request at a time: the next is read when its predecessor's answer has been taken, so a
    /// client that sends without reading is not read either. Dropping the stream drops the
    /// connection, which leaves its world.
    async fn process(
        &self,
        request: Request<Streaming<EnvironmentRequest>>,
    ) -> Result<Response<Self::ProcessStream>, Status> {
        let stage = Arc::new(SessionStage(Arc::clone(&self.sessions)));
        let connection = Connection::new(stage, Arc::clone(&self.worlds));
        let requests = request
            .into_inner()
            // What cannot be read ends the stream, with the reason.
            .scan(false, |is_broken, request| {
                let is_last = std::mem::replace(is_broken, request.is_err());
                future::ready((!is_last).then_some(request))
            })
            .take_until(self.draining.clone().cancelled_owned());
        let answers = stream::unfold(
            (Box::pin(requests), connection),
            |(mut requests, mut connection)| async move {
                let answer = match requests.next().await? {
                    Ok(request) => Ok(connection.answer(request).await.unwrap_or_else(failed)),
                    Err(status) => Err(status),
                };
                Some((answer, (requests, connection)))
            },
        );
        Ok(Response::new(Box::pin(answers)))
    }
}

fn failed(error: ServerError) -> EnvironmentResponse {
    EnvironmentResponse { payload: Some(Payload::Error(in_band(&error.into()))) }
}
