//! Which policy the server shall run.

use std::path::PathBuf;

use palr_gym_proto::v1;

use crate::error::ClientError;
use crate::imitate::manifest;

/// A policy by name or file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PolicySource {
    /// Uniform over the action space.
    Random,
    /// The expert that ships with the server.
    Expert,
    /// An ONNX file, or the folder of a finished run.
    File(PathBuf),
}

impl PolicySource {
    /// `random`, `expert`, or a path.
    #[must_use]
    pub fn parse(text: &str) -> Self {
        match text {
            "random" => Self::Random,
            "expert" => Self::Expert,
            path => Self::File(path.into()),
        }
    }

    /// What to call it in tables and metadata.
    #[must_use]
    pub fn label(&self) -> String {
        match self {
            Self::Random => "random".into(),
            Self::Expert => "expert".into(),
            Self::File(path) => path.display().to_string(),
        }
    }

    /// As the wire has it; reads the file.
    ///
    /// # Errors
    /// [`ClientError::File`]; [`ClientError::RunFolder`] for a folder without a finished run.
    pub fn load(&self) -> Result<v1::Policy, ClientError> {
        let policy = match self {
            Self::Random => v1::policy::Policy::Random(v1::RandomPolicy {}),
            Self::Expert => v1::policy::Policy::Expert(v1::ExpertPolicy {}),
            Self::File(path) => {
                let path = &match path.is_dir() {
                    true => manifest::policy_path(path)?,
                    false => path.clone(),
                };
                let model = std::fs::read(path).map_err(|error| {
                    ClientError::file(
                        path,
                        format!(
                            "{error}; expected `random`, `expert`, an ONNX policy or a run's folder"
                        ),
                    )
                })?;
                v1::policy::Policy::Onnx(model.into())
            }
        };
        Ok(v1::Policy { policy: Some(policy) })
    }
}

impl std::fmt::Display for PolicySource {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(&self.label())
    }
}
