//! The state machine of one connection.
//!
//! ```text
//! not joined ──join──► INTERRUPTED ──step──► RUNNING ──step──► TERMINATED or INTERRUPTED ──step──► RUNNING …
//!                                            RUNNING ──reset, or step after a reset of the world──► INTERRUPTED
//! ```

use std::sync::Arc;

use palr_gym_proto::dm_env_rpc::v1 as wire;
use palr_gym_proto::dm_env_rpc::v1::EnvironmentStateType as State;
use palr_gym_proto::dm_env_rpc::v1::environment_request::Payload as Request;
use palr_gym_proto::dm_env_rpc::v1::environment_response::Payload as Response;

use super::error::DmEnvRpcError;
use super::settings::{self, quoted};
use super::stage::{Env, Stage};
use super::tensors;
use super::worlds::{Place, Worlds};
use crate::error::ServerError;

/// One client's connection. Dropping it leaves the world.
pub struct Connection<S: Stage> {
    stage: Arc<S>,
    worlds: Arc<Worlds>,
    seat: Option<Seat<S::Env>>,
}

/// What a connection has in the world that it has joined.
struct Seat<E> {
    place: Place,
    env: E,
    state: State,
    /// The world's resets that it has taken notice of.
    resets: u64,
    /// From which the next episode starts.
    seed: Option<u64>,
    /// Shown again when a reset of the world interrupts the episode.
    observation: Vec<f64>,
}

impl<S: Stage> Connection<S> {
    /// A connection that has joined nothing.
    pub fn new(stage: Arc<S>, worlds: Arc<Worlds>) -> Self {
        Self { stage, worlds, seat: None }
    }

    /// Answers a request.
    ///
    /// # Errors
    /// Whatever is wrong with the request; then nothing has changed.
    pub async fn answer(
        &mut self,
        request: wire::EnvironmentRequest,
    ) -> Result<wire::EnvironmentResponse, ServerError> {
        let response = match request.payload.ok_or(DmEnvRpcError::NoRequest)? {
            Request::CreateWorld(request) => Response::CreateWorld(self.create_world(&request)?),
            Request::JoinWorld(request) => Response::JoinWorld(self.join_world(&request).await?),
            Request::Step(request) => Response::Step(self.step(&request).await?),
            Request::Reset(request) => Response::Reset(self.reset(&request)?),
            Request::ResetWorld(request) => {
                let seed = settings::seed(&request.settings)?;
                self.worlds.reset(&request.world_name, seed)?;
                Response::ResetWorld(wire::ResetWorldResponse {})
            }
            Request::LeaveWorld(_) => {
                self.seat = None;
                Response::LeaveWorld(wire::LeaveWorldResponse {})
            }
            Request::DestroyWorld(request) => {
                self.worlds.destroy(&request.world_name)?;
                Response::DestroyWorld(wire::DestroyWorldResponse {})
            }
            Request::Extension(any) => {
                return Err(DmEnvRpcError::NoExtension { type_url: quoted(&any.type_url) }.into());
            }
        };
        Ok(wire::EnvironmentResponse { payload: Some(response) })
    }

    fn create_world(
        &self,
        request: &wire::CreateWorldRequest,
    ) -> Result<wire::CreateWorldResponse, ServerError> {
        let settings = settings::world(&request.settings)?;
        self.stage.check(&settings.env_id)?;
        Ok(wire::CreateWorldResponse { world_name: self.worlds.create(settings)? })
    }

    async fn join_world(
        &mut self,
        request: &wire::JoinWorldRequest,
    ) -> Result<wire::JoinWorldResponse, ServerError> {
        if let Some(seat) = &self.seat {
            let world_name = seat.place.world_name().to_owned();
            return Err(DmEnvRpcError::AlreadyJoined { world_name }.into());
        }
        let seed = settings::seed(&request.settings)?;
        let (place, env_id) = self.worlds.join(&request.world_name)?;
        let env = self.stage.open(&env_id).await?;
        let specs = Some(tensors::specs(env.spec()));
        let world = place.view();
        self.seat = Some(Seat {
            place,
            env,
            state: State::Interrupted,
            resets: world.resets,
            seed: seed.or(world.seed),
            observation: Vec::new(),
        });
        Ok(wire::JoinWorldResponse { specs })
    }

    fn reset(&mut self, request: &wire::ResetRequest) -> Result<wire::ResetResponse, ServerError> {
        let seat = joined(&mut self.seat, "reset")?;
        let seed = settings::seed(&request.settings)?;
        seat.notice_resets();
        seat.seed = seed.or(seat.seed);
        seat.interrupt();
        Ok(wire::ResetResponse { specs: Some(tensors::specs(seat.env.spec())) })
    }

    async fn step(
        &mut self,
        request: &wire::StepRequest,
    ) -> Result<wire::StepResponse, ServerError> {
        let seat = joined(&mut self.seat, "step")?;
        let requested = &request.requested_observations;
        tensors::check_requested(requested)?;
        if seat.notice_resets() && seat.state == State::Running {
            seat.interrupt();
            return Ok(seat.response(requested, 0.0));
        }
        let mut reward = 0.0;
        if seat.state == State::Running {
            let action = tensors::action(&request.actions, seat.env.spec().action_size())?;
            let outcome = seat.env.step(action).await?;
            seat.observation = outcome.observation;
            reward = outcome.reward;
            // A terminal state is terminal even if time ran out as well.
            if outcome.terminated {
                seat.state = State::Terminated;
            } else if outcome.truncated {
                seat.state = State::Interrupted;
            }
        } else {
            // Whatever the action is, it is for no episode.
            seat.observation = seat.env.reset(seat.seed).await?;
            seat.seed = None;
            seat.state = State::Running;
        }
        Ok(seat.response(requested, reward))
    }
}

fn joined<'a, E>(
    seat: &'a mut Option<Seat<E>>,
    request: &'static str,
) -> Result<&'a mut Seat<E>, DmEnvRpcError> {
    seat.as_mut().ok_or(DmEnvRpcError::NotJoined { request })
}

impl<E> Seat<E> {
    /// True if the world was reset since the last look. Then the next episode starts as the world
    /// says.
    fn notice_resets(&mut self) -> bool {
        let world = self.place.view();
        let was_reset = std::mem::replace(&mut self.resets, world.resets) != world.resets;
        if was_reset {
            self.seed = world.seed;
        }
        was_reset
    }

    /// Ends a running episode. One that has ended stays as it ended.
    fn interrupt(&mut self) {
        if self.state == State::Running {
            self.state = State::Interrupted;
        }
    }

    fn response(&self, requested: &[u64], reward: f64) -> wire::StepResponse {
        wire::StepResponse {
            state: self.state.into(),
            observations: tensors::observations(requested, &self.observation, reward),
        }
    }
}
