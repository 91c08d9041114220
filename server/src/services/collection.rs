//! `CollectionService`.

use palr_gym_proto::v1::collect_response::Response as Kind;
use palr_gym_proto::v1::collection_service_server::CollectionService;
use palr_gym_proto::v1::{CollectRequest, CollectResponse, CollectionStarted};
use tonic::{Request, Response, Status, async_trait};

use super::Services;
use super::rollouts::{ResultStream, RolloutRequest};
use crate::convert;
use crate::encode::WireEncode;
use crate::rollout::collect;

#[async_trait]
impl CollectionService for Services {
    type CollectStream = ResultStream<CollectResponse>;

    async fn collect(
        &self,
        request: Request<CollectRequest>,
    ) -> Result<Response<Self::CollectStream>, Status> {
        let request = request.into_inner();
        let limits = &self.limits;
        let amount = convert::amount(request.amount, limits.max_transitions, limits.max_episodes)?;
        let first_episode = request.first_episode;
        let rollout = RolloutRequest {
            action_mode: convert::action_mode(request.action_mode)?,
            policy: convert::policy(request.policy)?,
            env_id: request.env_id,
            scene: request.scene_options.map(convert::scene_options).transpose()?,
            num_envs: request.num_envs,
            seed: request.seed,
        };
        tracing::info!(env_id = rollout.env_id, ?amount, first_episode, "collection started");
        let services = self.clone();
        let stream = self
            .roll_out(rollout, move |plan, actor, results| {
                let started = Kind::Started(CollectionStarted {
                    spec: Some(services.spec(&plan.spec, WireEncode::default())),
                    opengl: convert::opengl().filter(|_| plan.spec.shows_pictures()),
                    policy_sha256: actor.sha256().to_owned(),
                    num_envs: plan.num_envs as u32,
                });
                if !results.send(CollectResponse { response: Some(started) }) {
                    return Ok(());
                }
                collect(plan, actor, amount, first_episode, |episode| {
                    results.send(convert::episode_transitions(&plan.spec, &episode))
                })
            })
            .await?;
        Ok(Response::new(stream))
    }
}
