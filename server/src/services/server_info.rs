//! `ServerService`.

use palr_gym_core::env_id::MAX_FRAME_STACK;
use palr_gym_proto::v1::server_service_server::ServerService;
use palr_gym_proto::v1::{GetServerInfoRequest, GetServerInfoResponse, ServerLimits};
use palr_gym_sim::mujoco_log::mujoco_version;
use tonic::{Request, Response, Status, async_trait};

use super::Services;
use crate::convert;

#[async_trait]
impl ServerService for Services {
    async fn get_server_info(
        &self,
        _: Request<GetServerInfoRequest>,
    ) -> Result<Response<GetServerInfoResponse>, Status> {
        let limits = &self.limits;
        Ok(Response::new(GetServerInfoResponse {
            version: crate::VERSION.to_owned(),
            mujoco_version: mujoco_version().to_owned(),
            limits: Some(ServerLimits {
                max_sessions: limits.max_sessions as u32,
                max_envs_per_session: limits.max_envs_per_session as u32,
                max_envs: limits.max_envs as u32,
                max_frame_stack: MAX_FRAME_STACK as u32,
                max_message_bytes: limits.max_message_bytes as u64,
                max_policy_bytes: limits.policy.max_bytes as u64,
                max_episodes_per_request: limits.max_episodes,
                session_idle_limit_s: limits.session_idle.as_secs() as u32,
                max_answer_bytes: limits.max_answer_bytes as u64,
                max_open_loop_steps: limits.max_open_loop_steps as u32,
                max_snapshot_bytes: limits.max_snapshot_bytes as u64,
            }),
            simulation_threads: self.threads.count() as u32,
            opengl: convert::opengl(),
        }))
    }
}
