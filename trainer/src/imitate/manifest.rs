//! `run.json`: what a run's folder says of itself.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use palr_gym_proto::v1;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::error::ClientError;
use crate::imitate::data::{DataIdentity, Prepared};
use crate::imitate::settings::Settings;
use crate::learning::train::{CHECKPOINT_FILE, ONNX_FILE};

/// The manifest's name in a run's folder.
pub const FILE: &str = "run.json";
/// Of the folder's layout. A folder of another one is refused.
pub const FORMAT_VERSION: u32 = 1;
const KIND: &str = "imitation";

/// The manifest of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`FORMAT_VERSION`].
    pub format_version: u32,
    /// `imitation`.
    pub kind: String,
    /// Canonical id of the environment as which the policy sees the data.
    pub env_id: String,
    /// Seconds since 1970.
    pub started_at_unix_s: u64,
    /// Who trained, and who evaluated.
    pub versions: Versions,
    /// What was trained on.
    pub data: DataIdentity,
    /// Every setting.
    pub settings: Value,
}

/// Programs that had a part in a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Versions {
    /// Of the trainer.
    pub palr_gym: String,
    /// Of the source that the trainer was built from, if it was built in a repository.
    pub git_revision: Option<String>,
    /// Of the server.
    pub server: String,
    /// Of the server's MuJoCo.
    pub mujoco: String,
}

impl Manifest {
    /// Of a run that starts now.
    #[must_use]
    pub fn new(
        settings: &Settings,
        prepared: &Prepared,
        server: &v1::GetServerInfoResponse,
        git_revision: Option<&str>,
    ) -> Self {
        let since = SystemTime::now().duration_since(UNIX_EPOCH);
        Self {
            format_version: FORMAT_VERSION,
            kind: KIND.to_owned(),
            env_id: prepared.env_id.clone(),
            started_at_unix_s: since.map(|since| since.as_secs()).unwrap_or_default(),
            versions: Versions {
                palr_gym: env!("CARGO_PKG_VERSION").to_owned(),
                git_revision: git_revision.map(str::to_owned),
                server: server.version.clone(),
                mujoco: server.mujoco_version.clone(),
            },
            data: prepared.identity.clone(),
            settings: settings.to_json(),
        }
    }

    /// Reads that of `folder`.
    ///
    /// # Errors
    /// [`ClientError::RunFolder`] if there is none or it is of another version.
    pub fn read(folder: &Path) -> Result<Self, ClientError> {
        let wrong = |message: String| ClientError::RunFolder { path: folder.into(), message };
        let bytes = match std::fs::read(folder.join(FILE)) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Err(wrong(format!("is no run's folder: it holds no {FILE}")));
            }
            Err(error) => return Err(wrong(error.to_string())),
        };
        let unreadable = |error: serde_json::Error| wrong(format!("{FILE}: {error}"));
        let value: Value = serde_json::from_slice(&bytes).map_err(unreadable)?;
        // Before all else: other versions have other fields.
        match value.get("format_version").and_then(Value::as_u64) {
            Some(version) if version == u64::from(FORMAT_VERSION) => {}
            Some(version) => {
                let made = value.pointer("/versions/palr_gym").and_then(Value::as_str);
                return Err(wrong(format!(
                    "has format version {version}, made by palr-gym {}; this is palr-gym {}, which \
                     reads version {FORMAT_VERSION}. Use that palr-gym, or its policy.onnx",
                    made.unwrap_or("of unknown version"),
                    env!("CARGO_PKG_VERSION"),
                )));
            }
            None => return Err(wrong(format!("{FILE} states no format_version"))),
        }
        let manifest = Self::deserialize(value).map_err(unreadable)?;
        if manifest.kind != KIND {
            let message = format!("holds a run of kind {:?}; expected {KIND:?}", manifest.kind);
            return Err(wrong(message));
        }
        Ok(manifest)
    }

    /// Refuses to go on with other data.
    ///
    /// # Errors
    /// [`ClientError::RunFolder`].
    pub fn check_data(&self, folder: &Path, prepared: &Prepared) -> Result<(), ClientError> {
        if self.data == prepared.identity {
            return Ok(());
        }
        let message = format!(
            "trained on a file with sha256 {}; the data file now has {}. Restore it, or start anew",
            self.data.sha256, prepared.identity.sha256
        );
        Err(ClientError::RunFolder { path: folder.into(), message })
    }
}

/// The finished policy of the run in `folder`.
///
/// # Errors
/// [`ClientError::RunFolder`] if it holds no run, one of another version, or one that is not
/// finished.
pub fn policy_path(folder: &Path) -> Result<PathBuf, ClientError> {
    Manifest::read(folder)?;
    let policy = folder.join(ONNX_FILE);
    if policy.is_file() {
        return Ok(policy);
    }
    let state = if folder.join(CHECKPOINT_FILE).exists() { "is not finished" } else { "has begun" };
    Err(ClientError::RunFolder {
        path: folder.into(),
        message: format!(
            "holds a run that {state}; `palr-gym train --resume {}` goes on with it",
            folder.display()
        ),
    })
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn folders_without_a_manifest_or_of_another_version_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let refusal = || Manifest::read(folder.path()).unwrap_err().to_string();
        assert!(refusal().contains("is no run's folder: it holds no run.json"));
        for (manifest, want) in [
            (json!({}), "states no format_version"),
            (json!({"format_version": 7, "versions": {"palr_gym": "9.1.0"}}), "palr-gym 9.1.0;"),
            (json!({"format_version": 1}), "missing field"),
        ] {
            std::fs::write(folder.path().join(FILE), manifest.to_string()).unwrap();
            assert!(refusal().contains(want), "{}", refusal());
        }
        std::fs::write(folder.path().join(FILE), "{").unwrap();
        assert!(refusal().contains("run.json: EOF"), "{}", refusal());
    }
}
