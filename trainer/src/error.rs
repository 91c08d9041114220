//! What can go wrong on the client's side.

use std::path::PathBuf;

use tonic::Code;
use tonic_types::StatusExt;

use crate::learning::TrainError;

/// Why a call, or what was done with its result, failed.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The text is no address.
    #[error("{address:?} is no server address; expected HOST:PORT or unix:PATH")]
    Address {
        /// The text.
        address: String,
    },
    /// Nobody answers there.
    #[error(
        "cannot reach a palr-gym server at {address}: {message}; start one with `palr-gym serve`"
    )]
    Unreachable {
        /// Where it was looked for.
        address: String,
        /// What the transport said.
        message: String,
    },
    /// The server refused or failed.
    #[error("{message} ({code:?}{})", reason.as_deref().map(|reason| format!(", {reason}")).unwrap_or_default())]
    Status {
        /// gRPC's code.
        code: Code,
        /// The server's reason in upper snake case.
        reason: Option<String>,
        /// The server's text.
        message: String,
    },
    /// The server broke its own protocol.
    #[error("the server's answer makes no sense: {0}")]
    Protocol(String),
    /// A file.
    #[error("{}: {message}", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// What is wrong and what to do.
        message: String,
    },
    /// A data set.
    #[error(transparent)]
    Data(#[from] palr_gym_data::DataError),
    /// Pictures, which no method here learns from.
    #[error(
        "{env_id} shows pictures, and the methods learn from vectors; record and train on features instead, which the same id without -pixels shows"
    )]
    Pixels {
        /// The environment.
        env_id: String,
    },
    /// Features of another extractor than the server's.
    #[error(
        "{} holds features of the extractor with SHA-256 {got}; {env_id} shows those of {want} on this server. Record them anew, or serve with --extractor", path.display()
    )]
    Extractor {
        /// The file.
        path: PathBuf,
        /// The environment.
        env_id: String,
        /// As the file says.
        got: String,
        /// The server's.
        want: String,
    },
    /// A recording stopped half-way; what was recorded is kept.
    #[error("{cause}; {episodes} episodes ({transitions} transitions) are safe in {}, and --resume goes on from there", part.display())]
    Interrupted {
        /// What stopped it.
        cause: Box<ClientError>,
        /// Where the recording lies.
        part: PathBuf,
        /// Whole episodes in it.
        episodes: u32,
        /// Transitions in it.
        transitions: u64,
    },
    /// Settings in a file.
    #[error("{}: {cause}", path.display())]
    Settings {
        /// The file.
        path: PathBuf,
        /// What is wrong with them.
        cause: Box<ClientError>,
    },
    /// A run's folder that cannot be used.
    #[error("{} {message}", path.display())]
    RunFolder {
        /// The folder.
        path: PathBuf,
        /// What is wrong and what to do.
        message: String,
    },
    /// Training stopped because an evaluation beside it had failed.
    #[error("the policy of step {step} cannot be evaluated: an earlier evaluation failed")]
    EvaluationStopped {
        /// Steps taken.
        step: u64,
    },
    /// A defect of ours.
    #[error("{what} panicked: {message}; this is a defect, please report it")]
    Panicked {
        /// What.
        what: &'static str,
        /// What it said.
        message: String,
    },
    /// Training.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// One of several runs that train together.
    #[error("run {}: {cause}", run_folder.display())]
    OneOfMany {
        /// Of the run.
        run_folder: PathBuf,
        /// What is wrong with it.
        cause: Box<ClientError>,
    },
    /// A figure.
    #[error("cannot draw {}: {message}", path.display())]
    Plot {
        /// Where it should go.
        path: PathBuf,
        /// What the drawing library said.
        message: String,
    },
}

impl ClientError {
    /// True if the request was at fault, not the machine or the network.
    #[must_use]
    pub fn is_bad_request(&self) -> bool {
        match self {
            Self::Address { .. }
            | Self::Train(TrainError::Setting { .. } | TrainError::UnknownSetting { .. }) => true,
            Self::Settings { cause, .. } | Self::OneOfMany { cause, .. } => cause.is_bad_request(),
            Self::Status { code, .. } => {
                matches!(code, Code::InvalidArgument | Code::NotFound | Code::FailedPrecondition)
            }
            _ => false,
        }
    }

    /// [`Self::File`].
    pub fn file(path: impl Into<PathBuf>, message: impl std::fmt::Display) -> Self {
        Self::File { path: path.into(), message: message.to_string() }
    }
}

impl From<tonic::Status> for ClientError {
    fn from(status: tonic::Status) -> Self {
        let reason = status.get_details_error_info().map(|info| info.reason);
        Self::Status { code: status.code(), reason, message: status.message().to_owned() }
    }
}
