//! `EvaluationService`.

use palr_gym_proto::v1::evaluation_service_server::EvaluationService;
use palr_gym_proto::v1::{EvaluateRequest, EvaluateResponse};
use tonic::{Request, Response, Status, async_trait};

use super::Services;
use super::rollouts::{ResultStream, RolloutRequest};
use crate::convert;
use crate::rollout::evaluate;

/// Episodes when the caller does not say.
const DEFAULT_EPISODES: u32 = 20;

#[async_trait]
impl EvaluationService for Services {
    type EvaluateStream = ResultStream<EvaluateResponse>;

    async fn evaluate(
        &self,
        request: Request<EvaluateRequest>,
    ) -> Result<Response<Self::EvaluateStream>, Status> {
        let request = request.into_inner();
        let episodes = request.episodes.unwrap_or(DEFAULT_EPISODES);
        convert::in_range("episodes", u64::from(episodes), u64::from(self.limits.max_episodes))?;
        let rollout = RolloutRequest {
            action_mode: convert::action_mode(request.action_mode)?,
            policy: convert::policy(request.policy)?,
            env_id: request.env_id,
            scene: request.scene_options.map(convert::scene_options).transpose()?,
            num_envs: request.num_envs,
            seed: request.seed,
        };
        tracing::info!(env_id = rollout.env_id, episodes, "evaluation started");
        let stream = self
            .roll_out(rollout, move |plan, actor, results| {
                let summary = evaluate(plan, actor, episodes, |episode| {
                    results.send(convert::episode_result(&episode))
                })?;
                results.send(convert::evaluation_summary(&summary));
                Ok(())
            })
            .await?;
        Ok(Response::new(stream))
    }
}
