//! `SnapshotService`.

use std::sync::Arc;

use bytes::Bytes;
use palr_gym_proto::v1;
use palr_gym_proto::v1::snapshot_service_server::SnapshotService;
use tonic::{Request, Response, Status, async_trait};

use super::Services;
use super::environment::{WireSession, keep, mismatch};
use crate::encode::{WireAnswer, WireEncode};
use crate::error::ServerError;
use crate::session::Command;

#[async_trait]
impl SnapshotService for Services {
    async fn take_snapshot(
        &self,
        request: Request<v1::TakeSnapshotRequest>,
    ) -> Result<Response<v1::TakeSnapshotResponse>, Status> {
        let session = self.sessions.get(&request.get_ref().session_id)?;
        let snapshot = self.snapshot(&session).await?;
        Ok(Response::new(v1::TakeSnapshotResponse { snapshot }))
    }

    async fn restore_snapshot(
        &self,
        request: Request<v1::RestoreSnapshotRequest>,
    ) -> Result<Response<v1::RestoreSnapshotResponse>, Status> {
        let v1::RestoreSnapshotRequest { session_id, snapshot } = request.into_inner();
        let session = self.sessions.get(&session_id)?;
        let state = Some(standing(&session, Command::Restore { snapshot }).await?);
        Ok(Response::new(v1::RestoreSnapshotResponse { state }))
    }

    async fn open_snapshot(
        &self,
        request: Request<v1::OpenSnapshotRequest>,
    ) -> Result<Response<v1::OpenSnapshotResponse>, Status> {
        let (session, state) = self.open_from(request.into_inner().snapshot).await?;
        Ok(Response::new(v1::OpenSnapshotResponse { session: Some(session), state: Some(state) }))
    }

    async fn fork_session(
        &self,
        request: Request<v1::ForkSessionRequest>,
    ) -> Result<Response<v1::ForkSessionResponse>, Status> {
        let session = self.sessions.get(&request.get_ref().session_id)?;
        let snapshot = self.snapshot(&session).await?;
        let (session, state) = self.open_from(snapshot).await?;
        Ok(Response::new(v1::ForkSessionResponse { session: Some(session), state: Some(state) }))
    }
}

impl Services {
    async fn snapshot(&self, session: &WireSession) -> Result<Bytes, ServerError> {
        let (got, max) = (session.snapshot_len(), self.limits.max_snapshot_bytes);
        if got > max {
            return Err(ServerError::SnapshotTooLarge { id: session.id(), got, max });
        }
        match keep(session.submit(Command::Snapshot)).await? {
            WireAnswer::Snapshot(snapshot) => Ok(snapshot),
            _ => Err(mismatch()),
        }
    }

    async fn open_from(
        &self,
        snapshot: Bytes,
    ) -> Result<(v1::OpenSessionResponse, v1::RestoredState), ServerError> {
        let sessions = Arc::clone(&self.sessions);
        let opened = tokio::task::spawn_blocking(move || {
            sessions.open_snapshot(&snapshot, |tag| {
                WireEncode::from_tag(tag).ok_or(ServerError::SnapshotTag)
            })
        });
        let session = opened.await.map_err(|error| ServerError::Internal(error.to_string()))??;
        tracing::info!(
            session_id = %session.id(),
            env_id = %session.spec().env_id,
            num_envs = session.num_envs(),
            "session opened from a snapshot"
        );
        let state = standing(&session, Command::Standing).await?;
        Ok((self.opened(&session), state))
    }
}

/// Where a session stands after `command`.
async fn standing(
    session: &WireSession,
    command: Command,
) -> Result<v1::RestoredState, ServerError> {
    match keep(session.submit(command)).await? {
        WireAnswer::Restored(state) => Ok(state),
        _ => Err(mismatch()),
    }
}
