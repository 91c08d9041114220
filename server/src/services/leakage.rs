//! `LeakageService`.

use std::sync::Arc;

use faer::Mat;
use palr_gym_core::ActionMode;
use palr_gym_leakage::HscicConfig;
use palr_gym_proto::v1;
use palr_gym_proto::v1::estimate_leakage_request::Subject as WireSubject;
use palr_gym_proto::v1::leakage_service_server::LeakageService;
use tonic::{Request, Response, Status, async_trait};

use super::Services;
use crate::convert;
use crate::error::ServerError;
use crate::leakage::{LeakageOptions, PolicySubject, Subject, estimate};

const DEFAULT_RESAMPLES: u32 = 2000;
const MAX_RESAMPLES: u64 = 100_000;

#[async_trait]
impl LeakageService for Services {
    async fn estimate_leakage(
        &self,
        request: Request<v1::EstimateLeakageRequest>,
    ) -> Result<Response<v1::EstimateLeakageResponse>, Status> {
        if self.draining.is_cancelled() {
            return Err(ServerError::Draining.into());
        }
        let request = request.into_inner();
        let running = self.limits.max_rollouts;
        let permit = Arc::clone(&self.rollouts)
            .try_acquire_owned()
            .map_err(|_| ServerError::TooManyRollouts { running })?;
        let services = self.clone();
        let work = tokio::task::spawn_blocking(move || {
            let _permit = permit;
            services.estimate(request)
        });
        let response = work.await.map_err(|error| ServerError::Internal(error.to_string()))??;
        Ok(Response::new(response))
    }
}

impl Services {
    fn estimate(
        &self,
        request: v1::EstimateLeakageRequest,
    ) -> Result<v1::EstimateLeakageResponse, ServerError> {
        let defaults = HscicConfig::default();
        let options = LeakageOptions {
            config: HscicConfig {
                ridge: request.ridge.unwrap_or(defaults.ridge),
                bandwidth_sq: request.bandwidth_sq.unwrap_or(defaults.bandwidth_sq),
            },
            episode_lengths: request.episode_lengths.iter().map(|&n| n as usize).collect(),
            resamples: convert::in_range(
                "resamples",
                u64::from(request.resamples.unwrap_or(DEFAULT_RESAMPLES)),
                MAX_RESAMPLES,
            )? as usize,
            seed: request.seed,
        };
        let past_actions = self.array(request.past_actions.as_ref(), "past_actions")?;
        let given_actions = self.array(request.given_actions.as_ref(), "given_actions")?;
        let subject = match request.subject {
            Some(WireSubject::Representation(tensor)) => {
                Subject::Representation(self.array(Some(&tensor), "representation")?)
            }
            Some(WireSubject::Policy(policy)) => Subject::Policy(self.policy_subject(policy)?),
            None => {
                return Err(ServerError::Missing {
                    field: "subject",
                    want: "representation or policy",
                });
            }
        };
        let leakage = estimate(subject, &past_actions, &given_actions, &options)?;
        let per_point = &leakage.hscic.per_point;
        Ok(v1::EstimateLeakageResponse {
            hscic: leakage.hscic.value,
            hscic_low: leakage.interval.low,
            hscic_high: leakage.interval.high,
            is_by_episode: leakage.interval.is_by_episode,
            per_point: Some(convert::float64(per_point, &[per_point.len()])),
        })
    }

    fn array(
        &self,
        tensor: Option<&v1::Tensor>,
        field: &'static str,
    ) -> Result<Mat<f64>, ServerError> {
        convert::matrix(tensor, field, self.limits.max_leakage_samples)
    }

    fn policy_subject(
        &self,
        subject: v1::PolicyOnObservations,
    ) -> Result<PolicySubject, ServerError> {
        // The paper measures what a policy samples.
        let action_mode = match subject.action_mode() {
            v1::ActionMode::Unspecified => ActionMode::Sampled,
            _ => convert::action_mode(subject.action_mode)?,
        };
        Ok(PolicySubject {
            observations: self.array(subject.observations.as_ref(), "policy.observations")?,
            policy: convert::policy(subject.policy)?,
            spec: self.vision.resolve(&subject.env_id, None)?.1,
            action_mode,
            limits: self.limits.policy,
        })
    }
}
