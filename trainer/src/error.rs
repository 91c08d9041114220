//! What can go wrong on the client's side.

use std::path::PathBuf;

use tonic::Code;
use tonic_types::StatusExt;

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
    /// Training.
    #[error(transparent)]
    Train(#[from] crate::learning::TrainError),
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
            Self::Address { .. } => true,
            Self::Status { code, .. } => {
                matches!(code, Code::InvalidArgument | Code::NotFound | Code::FailedPrecondition)
            }
            _ => false,
        }
    }

    pub(crate) fn file(path: impl Into<PathBuf>, message: impl std::fmt::Display) -> Self {
        Self::File { path: path.into(), message: message.to_string() }
    }
}

impl From<tonic::Status> for ClientError {
    fn from(status: tonic::Status) -> Self {
        let reason = status.get_details_error_info().map(|info| info.reason);
        Self::Status { code: status.code(), reason, message: status.message().to_owned() }
    }
}
