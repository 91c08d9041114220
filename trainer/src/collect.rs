//! Demonstrations to a D4RL file, resumable.
//!
//! Episodes go to a journal beside the file as they arrive; when all are there, the file is
//! written from the journal under another name and renamed. So the file is whole or absent, and
//! an interruption at any moment costs at most the episodes that were in flight.

mod rows;
mod scene_record;

use std::path::{Path, PathBuf};

use palr_gym_core::{ActionMode, EnvId};
use palr_gym_data::{D4rlWriter, Metadata};
use palr_gym_proto::v1;
use palr_gym_proto::v1::collect_request::Amount;
use palr_gym_proto::v1::collect_response::Response;
use prost::Message;
use serde::{Deserialize, Serialize};

use self::rows::{decode, episode, length, shape};
use self::scene_record::SceneRecord;
use crate::client::Client;
use crate::error::ClientError;
use crate::evaluate::wire_action_mode;
use crate::journal::{Journal, Records};
use crate::policy::PolicySource;

/// What to collect, and where to.
#[derive(Debug, Clone)]
pub struct CollectOptions {
    /// Such as `hopper`; what it shows is what is recorded.
    pub env_id: String,
    /// Who plays.
    pub policy: PolicySource,
    /// How much.
    pub amount: Amount,
    /// Episode i is reset with seed + i.
    pub seed: u64,
    /// Deterministic or sampled actions.
    pub action_mode: ActionMode,
    /// Environments side by side; the server chooses if unset.
    pub num_envs: Option<u32>,
    /// Of a driving task; the defaults if unset.
    pub scene_options: Option<v1::SceneOptions>,
    /// The HDF5 file.
    pub out: PathBuf,
    /// What to do about what is there already.
    pub existing: Existing,
}

/// What to do about a file or an unfinished recording that is there already.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Existing {
    /// Refuse.
    #[default]
    Keep,
    /// Go on with an unfinished recording; leave a finished one as it is.
    Resume,
    /// Start over.
    Replace,
}

/// What was collected.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Collected {
    /// The HDF5 file.
    pub path: PathBuf,
    /// Rows.
    pub transitions: u64,
    /// Episodes, the last of which may be cut.
    pub episodes: u32,
    /// Episodes that were there from an earlier, interrupted run.
    pub resumed_episodes: u32,
    /// True if a finished file was there already and nothing was done.
    pub was_complete: bool,
}

/// How far a collection has come.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Progress {
    /// Rows.
    pub transitions: u64,
    /// Episodes.
    pub episodes: u32,
}

/// What is being collected: the first record of a journal, and `metadata/request` of a file. Two
/// recordings may be joined only if these are equal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Header {
    env_id: String,
    policy: String,
    policy_sha256: String,
    action_mode: String,
    seed: u64,
    num_envs: u32,
    transitions: Option<u64>,
    episodes: Option<u32>,
    /// Those that were chosen.
    #[serde(default)]
    scene_options: Option<SceneRecord>,
    palr_gym_version: String,
    mujoco_version: String,
    /// Of what made features, if the observations are features.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    extractor: String,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    extractor_sha256: String,
    /// Of what drew, if the observations are pictures or made of them.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    gl_library: String,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    gl_renderer: String,
    /// Names Mesa's version.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    gl_version: String,
}

/// A journal, open or not yet begun.
struct Recording {
    part: PathBuf,
    header: Option<Header>,
    journal: Option<Journal>,
    progress: Progress,
}

/// Where the journal of `out` lies.
#[must_use]
pub fn journal_path(out: &Path) -> PathBuf {
    with_suffix(out, ".part")
}

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}

/// Collects into `options.out` and calls `on_progress` after each episode.
///
/// # Errors
/// [`ClientError::File`] for files that are in the way or cannot be written, and whatever the
/// server refuses. What was recorded before stays, for [`Existing::Resume`].
pub async fn collect(
    client: &Client,
    options: &CollectOptions,
    mut on_progress: impl FnMut(Progress),
) -> Result<Collected, ClientError> {
    let (out, part) = (&options.out, journal_path(&options.out));
    if let Some(complete) = clear_the_way(options, &part)? {
        return Ok(complete);
    }
    let mut recording = Recording::open(part)?;
    let resumed_episodes = recording.progress.episodes;
    if recording.remaining(options.amount).is_some() || resumed_episodes == 0 {
        let recorded = recording.record(client, options, &mut on_progress).await;
        recorded.map_err(|cause| recording.interrupted(cause))?;
    } else {
        recording.check_header(options, None)?;
    }
    recording.journal = None;
    write_hdf5(&recording.part, out, recording.progress)
        .map_err(|cause| recording.interrupted(cause))?;
    let Recording { part, progress, .. } = recording;
    std::fs::remove_file(&part).map_err(|error| ClientError::file(&part, error))?;
    let Progress { transitions, episodes } = progress;
    Ok(Collected {
        path: out.clone(),
        transitions,
        episodes,
        resumed_episodes,
        was_complete: false,
    })
}

/// Deals with what is there already; `Some` if nothing is left to do.
fn clear_the_way(options: &CollectOptions, part: &Path) -> Result<Option<Collected>, ClientError> {
    let out = &options.out;
    match (options.existing, out.exists(), part.exists()) {
        (Existing::Resume, true, _) => describe_complete(options).map(Some),
        (Existing::Keep, true, _) => Err(ClientError::file(
            out,
            "exists already; choose another name, or --force to replace it",
        )),
        (Existing::Keep, false, true) => Err(ClientError::file(
            part,
            "an unfinished recording is here; --resume goes on with it, --force starts over",
        )),
        (Existing::Replace, _, true) => {
            std::fs::remove_file(part).map_err(|error| ClientError::file(part, error))?;
            Ok(None)
        }
        _ => Ok(None),
    }
}

fn describe_complete(options: &CollectOptions) -> Result<Collected, ClientError> {
    let out = &options.out;
    let foreign = || ClientError::file(out, "was not written by `palr-gym collect`");
    let summary = palr_gym_data::d4rl::summarize(out)?;
    let header: Header =
        summary.request.and_then(|text| serde_json::from_str(&text).ok()).ok_or_else(foreign)?;
    check_same(out, &header, &header.as_asked(options))?;
    Ok(Collected {
        path: out.clone(),
        transitions: summary.transitions,
        episodes: summary.episodes as u32,
        resumed_episodes: summary.episodes as u32,
        was_complete: true,
    })
}

impl Header {
    /// This header with everything that the user chooses as in `options`.
    fn as_asked(&self, options: &CollectOptions) -> Self {
        let (transitions, episodes) = match options.amount {
            Amount::Transitions(transitions) => (Some(transitions), None),
            Amount::Episodes(episodes) => (None, Some(episodes)),
        };
        let asked_env_id = options.env_id.parse::<EnvId>();
        Self {
            env_id: asked_env_id.map_or_else(|_| options.env_id.clone(), |id| id.to_string()),
            policy: options.policy.label(),
            action_mode: options.action_mode.name().to_owned(),
            seed: options.seed,
            num_envs: options.num_envs.unwrap_or(self.num_envs),
            transitions,
            episodes,
            scene_options: options.scene_options.as_ref().map(SceneRecord::of),
            ..self.clone()
        }
    }
}

/// Refuses to join recordings of different things, naming the first difference.
fn check_same(path: &Path, found: &Header, asked: &Header) -> Result<(), ClientError> {
    let fields = |header: &Header| match serde_json::to_value(header) {
        Ok(serde_json::Value::Object(fields)) => fields,
        _ => serde_json::Map::new(),
    };
    let (found, asked) = (fields(found), fields(asked));
    match found.iter().find(|(name, value)| asked.get(*name) != Some(value)) {
        None => Ok(()),
        Some((name, value)) => Err(ClientError::file(
            path,
            format!(
                "holds a recording with {name} = {value}, not {}; ask for the same, or --force to start over",
                asked.get(name).unwrap_or(&serde_json::Value::Null)
            ),
        )),
    }
}

impl Recording {
    /// Reads what a journal holds already; nothing if there is none.
    fn open(part: PathBuf) -> Result<Self, ClientError> {
        let mut recording =
            Self { part, header: None, journal: None, progress: Progress::default() };
        if !recording.part.exists() {
            return Ok(recording);
        }
        let mut records = Records::open(&recording.part)?;
        if let Some(first) = records.next() {
            let header = serde_json::from_slice(&first).map_err(|error| {
                ClientError::file(&recording.part, format!("has no readable header: {error}"))
            })?;
            recording.header = Some(header);
        }
        for record in records.by_ref() {
            let episode = decode(&recording.part, &record)?;
            recording.progress.transitions += length(&episode) as u64;
            recording.progress.episodes += 1;
        }
        recording.journal = Some(Journal::resume(&recording.part, &records)?);
        Ok(recording)
    }

    /// `cause`, with where the recorded episodes are, if there are any.
    fn interrupted(&self, cause: ClientError) -> ClientError {
        let Progress { transitions, episodes } = self.progress;
        if episodes == 0 || cause.is_bad_request() {
            return cause;
        }
        let (cause, part) = (Box::new(cause), self.part.clone());
        ClientError::Interrupted { cause, part, episodes, transitions }
    }

    /// What is still missing.
    fn remaining(&self, amount: Amount) -> Option<Amount> {
        let Progress { transitions, episodes } = self.progress;
        match amount {
            Amount::Transitions(wanted) => {
                wanted.checked_sub(transitions).filter(|&left| left > 0).map(Amount::Transitions)
            }
            Amount::Episodes(wanted) => {
                wanted.checked_sub(episodes).filter(|&left| left > 0).map(Amount::Episodes)
            }
        }
    }

    fn check_header(
        &mut self,
        options: &CollectOptions,
        fresh: Option<Header>,
    ) -> Result<(), ClientError> {
        match (&self.header, fresh) {
            (Some(found), Some(fresh)) => check_same(&self.part, found, &fresh),
            (Some(found), None) => check_same(&self.part, found, &found.as_asked(options)),
            (None, Some(fresh)) => {
                let mut journal = match self.journal.take() {
                    Some(journal) => journal,
                    None => Journal::create(&self.part)?,
                };
                journal.append(&serde_json::to_vec(&fresh).map_err(|error| {
                    ClientError::file(&self.part, format!("cannot encode the header: {error}"))
                })?)?;
                (self.journal, self.header) = (Some(journal), Some(fresh));
                Ok(())
            }
            (None, None) => Ok(()),
        }
    }

    /// Streams the missing episodes into the journal.
    async fn record(
        &mut self,
        client: &Client,
        options: &CollectOptions,
        on_progress: &mut impl FnMut(Progress),
    ) -> Result<(), ClientError> {
        let info = client.server_info().await?;
        let request = v1::CollectRequest {
            env_id: options.env_id.clone(),
            policy: Some(options.policy.load()?),
            // Nothing at all is for the server to refuse.
            amount: self.remaining(options.amount).or(Some(options.amount)),
            seed: options.seed,
            action_mode: wire_action_mode(options.action_mode).into(),
            num_envs: options.num_envs,
            first_episode: self.progress.episodes,
            scene_options: options.scene_options,
        };
        let mut service = client.collections();
        let mut stream = client.within(service.collect(request)).await?.into_inner();
        while let Some(message) = client.within(stream.message()).await? {
            match message.response {
                Some(Response::Started(started)) => {
                    let header = header(options, &info, started)?;
                    self.check_header(options, Some(header))?;
                }
                Some(Response::Episode(episode)) => {
                    let journal = self.journal.as_mut().ok_or_else(|| {
                        ClientError::Protocol("an episode came before the start".into())
                    })?;
                    journal.append(&episode.encode_to_vec())?;
                    self.progress.transitions += length(&episode) as u64;
                    self.progress.episodes += 1;
                    on_progress(self.progress);
                }
                None => {}
            }
        }
        match self.remaining(options.amount) {
            None => Ok(()),
            Some(_) => Err(ClientError::Protocol("the collection ended too early".into())),
        }
    }
}

fn header(
    options: &CollectOptions,
    info: &v1::GetServerInfoResponse,
    started: v1::CollectionStarted,
) -> Result<Header, ClientError> {
    let spec = started.spec.ok_or_else(|| ClientError::Protocol("no spec in the answer".into()))?;
    let extractor = spec.feature_extractor.unwrap_or_default();
    let opengl = started.opengl.unwrap_or_default();
    let server_side = Header {
        env_id: spec.env_id,
        policy_sha256: started.policy_sha256,
        num_envs: started.num_envs,
        palr_gym_version: info.version.clone(),
        mujoco_version: info.mujoco_version.clone(),
        extractor: extractor.name,
        extractor_sha256: extractor.sha256,
        gl_library: opengl.library,
        gl_renderer: opengl.renderer,
        gl_version: opengl.version,
        policy: String::new(),
        action_mode: String::new(),
        seed: 0,
        transitions: None,
        episodes: None,
        scene_options: None,
    };
    Ok(server_side.as_asked(options))
}

/// Writes the journal's episodes to `out`, by way of a file that is renamed when it is whole.
fn write_hdf5(part: &Path, out: &Path, progress: Progress) -> Result<(), ClientError> {
    let mut records = Records::open(part)?;
    let header = records.next().ok_or_else(|| ClientError::file(part, "holds no header"))?;
    let header: Header = serde_json::from_slice(&header)
        .map_err(|error| ClientError::file(part, format!("has no readable header: {error}")))?;
    let partial = with_suffix(out, ".writing");
    let written = write_episodes(part, &partial, &header, records, progress);
    if written.is_err() {
        // The journal still has everything; a torn file has nothing to add.
        let _ = std::fs::remove_file(&partial);
    }
    written?;
    std::fs::rename(&partial, out).map_err(|error| ClientError::file(out, error))
}

fn write_episodes(
    part: &Path,
    partial: &Path,
    header: &Header,
    records: Records,
    progress: Progress,
) -> Result<(), ClientError> {
    let mut writer = None;
    for record in records {
        let wire = decode(part, &record)?;
        let episode = episode(&wire);
        let writer = match &mut writer {
            Some(writer) => writer,
            None => {
                let shape = shape(&episode, &wire, progress);
                let metadata = metadata(header, progress)?;
                writer.insert(D4rlWriter::create(partial, shape, &metadata)?)
            }
        };
        writer.append(&episode)?;
    }
    writer.ok_or_else(|| ClientError::file(part, "holds no episode"))?.finish()?;
    Ok(())
}

fn metadata(
    header: &Header,
    progress: Progress,
) -> Result<Vec<(&'static str, Metadata)>, ClientError> {
    let request = serde_json::to_string(header)
        .map_err(|error| ClientError::Protocol(format!("cannot encode the request: {error}")))?;
    let text = |value: &str| Metadata::Text(value.to_owned());
    let seen = [
        ("extractor", &header.extractor),
        ("extractor_sha256", &header.extractor_sha256),
        ("gl_library", &header.gl_library),
        ("gl_renderer", &header.gl_renderer),
        ("gl_version", &header.gl_version),
    ];
    let seen = seen.into_iter().filter(|(_, value)| !value.is_empty());
    let mut metadata = vec![
        ("action_mode", text(&header.action_mode)),
        ("env_id", text(&header.env_id)),
        ("episodes", Metadata::Integer(i64::from(progress.episodes))),
        ("mujoco_version", text(&header.mujoco_version)),
        ("num_envs", Metadata::Integer(i64::from(header.num_envs))),
        ("palr_gym_version", text(&header.palr_gym_version)),
        ("policy", text(&header.policy)),
        ("policy_sha256", text(&header.policy_sha256)),
        ("request", Metadata::Text(request)),
        ("seed", Metadata::Integer(header.seed.cast_signed())),
    ];
    metadata.extend(seen.map(|(name, value)| (name, text(value))));
    Ok(metadata)
}
