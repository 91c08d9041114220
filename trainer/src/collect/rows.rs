//! Episodes as they come, as rows of a file.

use std::borrow::Cow;
use std::path::Path;

use palr_gym_data::{D4rlShape, Episode};
use palr_gym_proto::v1;
use prost::Message;

use super::Progress;
use crate::error::ClientError;

pub(super) fn decode(path: &Path, record: &[u8]) -> Result<v1::EpisodeTransitions, ClientError> {
    v1::EpisodeTransitions::decode(record)
        .map_err(|error| ClientError::file(path, format!("holds an unreadable episode: {error}")))
}

pub(super) fn length(episode: &v1::EpisodeTransitions) -> usize {
    episode.rewards.as_ref().map_or(0, |rewards| rewards.data.len() / size_of::<f64>())
}

pub(super) fn shape(
    episode: &Episode<'_>,
    wire: &v1::EpisodeTransitions,
    progress: Progress,
) -> D4rlShape {
    let width = |count: usize| count / episode.len().max(1);
    D4rlShape {
        transitions: progress.transitions as usize,
        observation_size: width(episode.observations.len()),
        picture: wire.observations.as_ref().and_then(picture),
        action_size: width(episode.actions.len()),
        nq: width(episode.qpos.len()),
        nv: width(episode.qvel.len()),
        has_action_log_probs: wire.action_log_probs.is_some(),
    }
}

/// Height, width and channels, if these are pictures.
fn picture(observations: &v1::Tensor) -> Option<[usize; 3]> {
    match (observations.dtype(), &observations.shape[..]) {
        (v1::DataType::Uint8, &[_, height, width, channels]) => {
            Some([height as usize, width as usize, channels as usize])
        }
        _ => None,
    }
}

/// Observations, which are bytes if they are pictures.
fn frames(tensor: Option<&v1::Tensor>) -> Cow<'_, [f64]> {
    match tensor {
        Some(pictures) if pictures.dtype() == v1::DataType::Uint8 => {
            pictures.data.iter().copied().map(f64::from).collect()
        }
        _ => values(tensor),
    }
}

pub(super) fn episode(wire: &v1::EpisodeTransitions) -> Episode<'_> {
    Episode {
        index: wire.index,
        observations: frames(wire.observations.as_ref()),
        actions: values(wire.actions.as_ref()),
        rewards: values(wire.rewards.as_ref()),
        next_observations: frames(wire.next_observations.as_ref()),
        qpos: values(wire.qpos.as_ref()),
        qvel: values(wire.qvel.as_ref()),
        action_log_probs: values(wire.action_log_probs.as_ref()),
        terminated: wire.terminated,
        timed_out: wire.truncated || wire.cut,
    }
}

/// A tensor's elements; none for an unset or misshapen one, which the writer then refuses.
fn values<T: bytemuck::AnyBitPattern + bytemuck::NoUninit>(
    tensor: Option<&v1::Tensor>,
) -> Cow<'_, [T]> {
    let bytes: &[u8] = tensor.map_or(&[], |tensor| &tensor.data);
    if !bytes.len().is_multiple_of(size_of::<T>()) {
        return Cow::Owned(Vec::new());
    }
    Cow::Owned(bytemuck::allocation::pod_collect_to_vec(bytes))
}
