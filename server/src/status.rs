//! The one map from domain errors to gRPC statuses.
//!
//! Every status carries `google.rpc.ErrorInfo` with domain `palr_gym` and a reason that never
//! changes meaning; bad arguments also carry `BadRequest`, and refusals for lack of room
//! `RetryInfo`. The matches are exhaustive: a new error must be placed here to compile.

use std::collections::HashMap;
use std::time::Duration;

use palr_gym_core::EnvIdError;
use palr_gym_leakage::LeakageError;
use palr_gym_onnx::OnnxError;
use palr_gym_proto::google::rpc;
use palr_gym_sim::render::RenderError;
use palr_gym_sim::{SimError, SnapshotError};
use palr_gym_vision::VisionError;
use prost::Message;
use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};

use crate::dm_env_rpc::DmEnvRpcError;
use crate::error::ServerError;

/// Domain of every `ErrorInfo`.
pub const ERROR_DOMAIN: &str = "palr_gym";

/// Where an error belongs: status code, reason, and the request field at fault, if there is one.
struct Place {
    code: Code,
    reason: &'static str,
    field: Option<&'static str>,
}

const fn invalid(reason: &'static str, field: &'static str) -> Place {
    Place { code: Code::InvalidArgument, reason, field: Some(field) }
}

const fn place(code: Code, reason: &'static str) -> Place {
    Place { code, reason, field: None }
}

fn place_env_id(error: &EnvIdError) -> Place {
    match error {
        EnvIdError::NoTask { .. }
        | EnvIdError::UnexpectedPart { .. }
        | EnvIdError::FrameStack { .. }
        | EnvIdError::Version { .. } => invalid("INVALID_ENV_ID", "env_id"),
    }
}

fn place_sim(error: &SimError) -> Place {
    match error {
        SimError::EnvId(error) => place_env_id(error),
        SimError::UnknownTask { .. } => {
            Place { code: Code::NotFound, reason: "UNKNOWN_TASK", field: Some("env_id") }
        }
        SimError::View { .. } => invalid("UNKNOWN_VARIANT", "env_id"),
        SimError::SceneOptions(_) => invalid("SCENE_OPTIONS", "scene_options"),
        SimError::Scene { .. } => place(Code::Internal, "SCENE"),
        SimError::Memory { .. } => place(Code::ResourceExhausted, "MEMORY"),
        SimError::Snapshot(SnapshotError::Mismatch { .. }) => {
            invalid("SNAPSHOT_MISMATCH", "snapshot")
        }
        SimError::Snapshot(
            SnapshotError::NotASnapshot { .. }
            | SnapshotError::Version { .. }
            | SnapshotError::Checksum
            | SnapshotError::Malformed { .. },
        ) => invalid("INVALID_SNAPSHOT", "snapshot"),
        SimError::Render(error) => place_render(error),
        SimError::Extractor(_) => place(Code::FailedPrecondition, "FEATURE_EXTRACTOR"),
        SimError::Engine(_) => place(Code::Internal, "ENGINE"),
        SimError::Threads { .. } => place(Code::Internal, "THREADS"),
        SimError::ActionCount { .. } => invalid("ACTION_SHAPE", "actions"),
        SimError::ActionNan { .. } => invalid("ACTION_NAN", "actions"),
        SimError::ActionOutOfBounds { .. } => invalid("ACTION_OUT_OF_BOUNDS", "actions"),
        SimError::SeedCount { .. } => invalid("SEED_COUNT", "seeds"),
        SimError::EnvIndex { .. } => invalid("ENV_INDEX", "env_indices"),
        SimError::ResetNeeded { .. } | SimError::NeverReset => {
            place(Code::FailedPrecondition, "RESET_NEEDED")
        }
    }
}

fn place_render(error: &RenderError) -> Place {
    match error {
        RenderError::Disabled => place(Code::FailedPrecondition, "RENDERING_DISABLED"),
        RenderError::NoGl { .. } => place(Code::FailedPrecondition, "OPENGL_MISSING"),
        RenderError::OtherLibrary { .. } | RenderError::Context { .. } => {
            place(Code::FailedPrecondition, "OPENGL_CONTEXT")
        }
        RenderError::Engine { .. } => place(Code::FailedPrecondition, "OPENGL_UNFIT"),
        RenderError::Camera { .. } => invalid("UNKNOWN_CAMERA", "camera"),
        RenderError::Size { .. } => invalid("IMAGE_SIZE", "width_px"),
    }
}

fn place_vision(error: &VisionError) -> Place {
    match error {
        VisionError::Model(OnnxError::RuntimeMissing { .. }) => {
            place(Code::FailedPrecondition, "ORT_MISSING")
        }
        VisionError::File { .. }
        | VisionError::Model(_)
        | VisionError::Metadata { .. }
        | VisionError::Size { .. }
        | VisionError::Batch
        | VisionError::Pictures { .. } => place(Code::FailedPrecondition, "FEATURE_EXTRACTOR"),
    }
}

fn place_policy(error: &OnnxError) -> Place {
    match error {
        OnnxError::RuntimeMissing { .. } => place(Code::FailedPrecondition, "ORT_MISSING"),
        OnnxError::TooLarge { .. } => invalid("POLICY_TOO_LARGE", "policy.onnx"),
        OnnxError::NotOnnx { .. } => invalid("POLICY_NOT_ONNX", "policy.onnx"),
        OnnxError::ExternalData { .. } => invalid("POLICY_EXTERNAL_DATA", "policy.onnx"),
        OnnxError::Shape { .. } => invalid("POLICY_SHAPE", "policy.onnx"),
        OnnxError::NotStochastic { .. } => invalid("POLICY_NOT_STOCHASTIC", "action_mode"),
        OnnxError::NotFinite { .. } => invalid("POLICY_NOT_FINITE", "policy.onnx"),
        OnnxError::TooSlow { .. } => invalid("POLICY_TOO_SLOW", "policy.onnx"),
        OnnxError::Failed { .. } => invalid("POLICY_FAILED", "policy.onnx"),
    }
}

fn place_leakage(error: &LeakageError) -> Place {
    match error {
        LeakageError::Length { .. } => invalid("SAMPLE_COUNT", "past_actions"),
        LeakageError::TooFew { .. } => invalid("SAMPLE_COUNT", "representation"),
        LeakageError::NoColumns { .. } => invalid("ARRAY_SHAPE", "representation"),
        LeakageError::NotFinite { .. } => invalid("ARRAY_NOT_FINITE", "representation"),
        LeakageError::Constant { name, .. } => invalid(
            "ARRAY_CONSTANT",
            match *name {
                "past_action" => "past_actions",
                "given_action" => "given_actions",
                other => other,
            },
        ),
        LeakageError::NotPositive { .. } => invalid("OUT_OF_RANGE", "ridge"),
        LeakageError::Singular { .. } => invalid("SINGULAR", "ridge"),
        LeakageError::Blocks { .. } => invalid("EPISODE_LENGTHS", "episode_lengths"),
    }
}

fn place_dm_env_rpc(error: &DmEnvRpcError) -> Place {
    match error {
        DmEnvRpcError::NoRequest => invalid("MISSING", "payload"),
        DmEnvRpcError::NoExtension { .. } => place(Code::Unimplemented, "NO_EXTENSION"),
        DmEnvRpcError::UnknownSetting { .. } => invalid("UNKNOWN_SETTING", "settings"),
        DmEnvRpcError::Setting { .. } => invalid("SETTING", "settings"),
        DmEnvRpcError::UnknownWorld { .. } => {
            Place { code: Code::NotFound, reason: "WORLD_NOT_FOUND", field: Some("world_name") }
        }
        DmEnvRpcError::AlreadyJoined { .. } => place(Code::FailedPrecondition, "ALREADY_JOINED"),
        DmEnvRpcError::NotJoined { .. } => place(Code::FailedPrecondition, "NOT_JOINED"),
        DmEnvRpcError::WorldInUse { .. } => place(Code::FailedPrecondition, "WORLD_IN_USE"),
        DmEnvRpcError::TooManyWorlds { .. } => place(Code::ResourceExhausted, "TOO_MANY_WORLDS"),
        DmEnvRpcError::UnknownObservation { .. } => {
            invalid("UNKNOWN_OBSERVATION", "requested_observations")
        }
        DmEnvRpcError::UnknownAction { .. } => invalid("UNKNOWN_ACTION", "actions"),
        DmEnvRpcError::ActionType { .. } => invalid("ACTION_DTYPE", "actions"),
        DmEnvRpcError::ActionShape { .. } => invalid("ACTION_SHAPE", "actions"),
    }
}

fn place_server(error: &ServerError) -> Place {
    match error {
        ServerError::Sim(error) => place_sim(error),
        ServerError::Vision(error) => place_vision(error),
        ServerError::Policy(error) | ServerError::PolicyInEpisode { source: error, .. } => {
            place_policy(error)
        }
        ServerError::Leakage(error) => place_leakage(error),
        ServerError::DmEnvRpc(error) => place_dm_env_rpc(error),
        ServerError::Array { field, .. } => invalid("ARRAY_SHAPE", field),
        ServerError::SessionNotFound { .. } => {
            Place { code: Code::NotFound, reason: "SESSION_NOT_FOUND", field: Some("session_id") }
        }
        ServerError::SessionBroken { .. } => place(Code::Internal, "SESSION_BROKEN"),
        ServerError::NumEnvs { .. } => invalid("NUM_ENVS", "num_envs"),
        ServerError::TooManySessions { .. } => place(Code::ResourceExhausted, "TOO_MANY_SESSIONS"),
        ServerError::TooManyEnvs { .. } => place(Code::ResourceExhausted, "TOO_MANY_ENVS"),
        ServerError::QueueFull { .. } => place(Code::ResourceExhausted, "QUEUE_FULL"),
        ServerError::TooManyConnections => place(Code::ResourceExhausted, "TOO_MANY_CONNECTIONS"),
        ServerError::TooMuchArriving { .. } => place(Code::ResourceExhausted, "TOO_MUCH_ARRIVING"),
        ServerError::TooSlow { .. } => place(Code::DeadlineExceeded, "TOO_SLOW"),
        ServerError::NotRead { .. } => place(Code::DeadlineExceeded, "NOT_READ"),
        ServerError::TooManyRollouts { .. } => place(Code::ResourceExhausted, "TOO_MANY_ROLLOUTS"),
        ServerError::ActionDtype { .. } => invalid("ACTION_DTYPE", "actions.dtype"),
        ServerError::ActionShape { .. } => invalid("ACTION_SHAPE", "actions.shape"),
        ServerError::OpenLoop { .. } => invalid("OPEN_LOOP_TOO_LARGE", "actions.shape"),
        ServerError::SnapshotTag => invalid("SNAPSHOT_MISMATCH", "snapshot"),
        ServerError::SnapshotTooLarge { .. } => {
            place(Code::FailedPrecondition, "SNAPSHOT_TOO_LARGE")
        }
        ServerError::PicturesTooLarge { .. } => invalid("PICTURES_TOO_LARGE", "env_indices"),
        ServerError::Missing { field, .. } => invalid("MISSING", field),
        ServerError::UnknownEnum { field, .. } => invalid("UNKNOWN_ENUM", field),
        ServerError::OutOfRange { field, .. } => invalid("OUT_OF_RANGE", field),
        ServerError::NoExpert { .. } => place(Code::NotFound, "NO_EXPERT"),
        ServerError::NotStochastic { .. } => invalid("POLICY_NOT_STOCHASTIC", "action_mode"),
        ServerError::Draining => place(Code::Unavailable, "DRAINING"),
        ServerError::Cancelled => place(Code::Cancelled, "CANCELLED"),
        ServerError::Internal(_) => place(Code::Internal, "INTERNAL"),
    }
}

/// The values of an error that a program may want without parsing its text.
fn metadata(error: &ServerError) -> HashMap<String, String> {
    let pairs: &[(&str, String)] = match error {
        ServerError::Sim(SimError::UnknownTask { task, suggestion, .. }) => {
            &[("task", task.clone()), ("suggestion", suggestion.unwrap_or_default().to_owned())]
        }
        ServerError::Sim(
            SimError::ActionNan { env_index, index, .. }
            | SimError::ActionOutOfBounds { env_index, index, .. },
        ) => &[("env_index", env_index.to_string()), ("index", index.to_string())],
        ServerError::Sim(SimError::ResetNeeded { env_index }) => {
            &[("env_index", env_index.to_string())]
        }
        ServerError::PolicyInEpisode { episode, step, .. } => {
            &[("episode", episode.to_string()), ("step", step.to_string())]
        }
        ServerError::SessionNotFound { id, .. } => &[("session_id", id.clone())],
        ServerError::NumEnvs { got, max } => {
            &[("num_envs", got.to_string()), ("max", max.to_string())]
        }
        ServerError::NoExpert { task, .. } => &[("task", (*task).to_owned())],
        _ => &[],
    };
    pairs.iter().map(|(key, value)| ((*key).to_owned(), value.clone())).collect()
}

impl From<ServerError> for Status {
    fn from(error: ServerError) -> Self {
        let Place { code, reason, field } = place_server(&error);
        let message = error.to_string();
        if code == Code::Internal {
            tracing::error!(reason, "{message}");
        } else {
            tracing::debug!(reason, "request refused: {message}");
        }
        let mut details = ErrorDetails::with_error_info(reason, ERROR_DOMAIN, metadata(&error));
        if let Some(field) = field {
            details.add_bad_request_violation(field, &message);
        }
        if code == Code::ResourceExhausted {
            details.set_retry_info(Some(Duration::from_secs(1)));
        }
        Self::with_error_details(code, message, details)
    }
}

/// The same status as a message, for streams that go on after an error.
#[must_use]
pub fn in_band(status: &Status) -> rpc::Status {
    // `with_error_details` put this very message into the status's trailer.
    rpc::Status::decode(status.details()).unwrap_or_else(|_| rpc::Status {
        code: status.code() as i32,
        message: status.message().to_owned(),
        details: Vec::new(),
    })
}
