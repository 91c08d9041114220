//! Domain values to messages and back.

use bytes::Bytes;
use faer::Mat;
use palr_gym_core::{
    ActionMode, AutoresetMode, BoxSpace, EnvSpec, Fidelity, Mask, ObservationKind, OutOfBounds,
    SceneOptions, WeatherMode,
};
use palr_gym_proto::v1;
use palr_gym_sim::render::gl_info;
use palr_gym_sim::{Task, VectorOptions, tasks};
use palr_gym_vision::Extractor;

use crate::encode::ObservationType;
use crate::error::ServerError;
use crate::experts;
use crate::pictures::{ImageFormat, Pictures};
use crate::rollout::{Amount, EpisodeResult, EpisodeTransitions, EvaluationSummary, PolicyChoice};

// Payloads are little-endian; so is every machine that MuJoCo's wheels exist for.
const _: () = assert!(cfg!(target_endian = "little"));

/// A float64 tensor.
pub(crate) fn float64(values: &[f64], shape: &[usize]) -> v1::Tensor {
    tensor(v1::DataType::Float64, bytemuck::cast_slice(values), shape)
}

/// A float32 tensor.
pub(crate) fn float32(values: &[f32], shape: &[usize]) -> v1::Tensor {
    tensor(v1::DataType::Float32, bytemuck::cast_slice(values), shape)
}

/// A bool tensor, one byte an element.
pub(crate) fn boolean(values: &[bool], shape: &[usize]) -> v1::Tensor {
    tensor(v1::DataType::Bool, bytemuck::cast_slice(values), shape)
}

fn tensor(dtype: v1::DataType, bytes: &[u8], shape: &[usize]) -> v1::Tensor {
    v1::Tensor {
        dtype: dtype.into(),
        shape: shape.iter().map(|&size| size as i64).collect(),
        data: Bytes::copy_from_slice(bytes),
    }
}

/// A float32 or float64 tensor `[rows, columns]` with at most `max_rows` rows.
///
/// # Errors
/// [`ServerError::Missing`] or [`ServerError::Array`].
pub fn matrix(
    tensor: Option<&v1::Tensor>,
    field: &'static str,
    max_rows: usize,
) -> Result<Mat<f64>, ServerError> {
    let tensor = tensor
        .ok_or(ServerError::Missing { field, want: "a float32 or float64 tensor [n, columns]" })?;
    let wrong = |want: String| {
        let shape: Vec<i64> = tensor.shape.iter().copied().take(8).collect();
        let (dtype, bytes) = (tensor.dtype().as_str_name(), tensor.data.len());
        ServerError::Array { field, got: format!("{dtype} {shape:?} in {bytes} bytes"), want }
    };
    let size_of_element = match tensor.dtype() {
        v1::DataType::Float32 => size_of::<f32>(),
        v1::DataType::Float64 => size_of::<f64>(),
        v1::DataType::Unspecified | v1::DataType::Bool | v1::DataType::Uint8 => {
            return Err(wrong("float32 or float64".into()));
        }
    };
    let sizes: Option<Vec<usize>> =
        tensor.shape.iter().map(|&size| usize::try_from(size).ok()).collect();
    let Some(&[rows, columns]) = sizes.as_deref() else {
        return Err(wrong("two dimensions, [n, columns]".into()));
    };
    if rows > max_rows {
        return Err(wrong(format!("at most {max_rows} rows")));
    }
    if rows.checked_mul(columns).and_then(|count| count.checked_mul(size_of_element))
        != Some(tensor.data.len())
    {
        return Err(wrong("as many bytes as shape and dtype say".into()));
    }
    let values: Vec<f64> = if size_of_element == size_of::<f32>() {
        let values: Vec<f32> = bytemuck::allocation::pod_collect_to_vec(&tensor.data);
        values.into_iter().map(f64::from).collect()
    } else {
        bytemuck::allocation::pod_collect_to_vec(&tensor.data)
    };
    Ok(Mat::from_fn(rows, columns, |i, j| values[i * columns + j]))
}

/// The actions of one step, or of several.
#[derive(Debug, PartialEq)]
pub struct Actions {
    /// `[steps, num_envs, action_size]`.
    pub values: Vec<f32>,
    /// Set if the actions are those of an open loop.
    pub open_loop: Option<usize>,
}

/// The actions of a step, float32 `[num_envs, action_size]`, or of several,
/// `[K, num_envs, action_size]`.
///
/// # Errors
/// [`ServerError::Missing`], [`ServerError::ActionDtype`] or [`ServerError::ActionShape`].
pub fn actions(
    tensor: Option<&v1::Tensor>,
    num_envs: usize,
    action_size: usize,
) -> Result<Actions, ServerError> {
    let tensor = tensor.ok_or(ServerError::Missing {
        field: "actions",
        want: "a float32 tensor [num_envs, action size]",
    })?;
    if tensor.dtype() != v1::DataType::Float32 {
        let got = match tensor.dtype() {
            v1::DataType::Unspecified => format!("unspecified ({})", tensor.dtype),
            v1::DataType::Float32 => "float32".to_owned(),
            v1::DataType::Float64 => "float64".to_owned(),
            v1::DataType::Bool => "bool".to_owned(),
            v1::DataType::Uint8 => "uint8".to_owned(),
        };
        return Err(ServerError::ActionDtype { got });
    }
    let own = [num_envs as i64, action_size as i64];
    let open_loop = match *tensor.shape {
        [steps, rows, columns] if [rows, columns] == own && steps >= 1 => Some(steps as usize),
        _ => None,
    };
    let is_shaped = open_loop.is_some() || tensor.shape == own;
    let count = (num_envs * action_size).checked_mul(open_loop.unwrap_or(1));
    if !is_shaped || count.and_then(|count| count.checked_mul(4)) != Some(tensor.data.len()) {
        return Err(ServerError::ActionShape {
            // As much of a stranger's shape as is worth quoting.
            got: tensor.shape.iter().copied().take(8).collect(),
            bytes: tensor.data.len(),
            num_envs,
            action_size,
        });
    }
    // The payload sits at any address inside the received message.
    Ok(Actions { values: bytemuck::allocation::pod_collect_to_vec(&tensor.data), open_loop })
}

pub(crate) fn observation_type(value: i32) -> Result<ObservationType, ServerError> {
    let want = "FLOAT64 or FLOAT32";
    match known(value, "observation_dtype", want)? {
        v1::DataType::Unspecified | v1::DataType::Float64 => Ok(ObservationType::Float64),
        v1::DataType::Float32 => Ok(ObservationType::Float32),
        v1::DataType::Bool | v1::DataType::Uint8 => {
            Err(ServerError::UnknownEnum { field: "observation_dtype", got: value, want })
        }
    }
}

fn fidelity(fidelity: Fidelity) -> v1::Fidelity {
    match fidelity {
        Fidelity::Gym4 => v1::Fidelity::Gym4,
        Fidelity::Gym5 => v1::Fidelity::Gym5,
    }
}

fn names(names: &[&str]) -> Vec<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

fn box_space(space: BoxSpace, dtype: v1::DataType) -> v1::BoxSpace {
    v1::BoxSpace {
        dtype: dtype.into(),
        shape: space.shape.iter().map(|&size| size as i64).collect(),
        low: space.low,
        high: space.high,
        names: space.names,
    }
}

fn mask(mask: Mask) -> v1::Mask {
    match mask {
        Mask::Full => v1::Mask::Full,
        Mask::Paper => v1::Mask::Paper,
        Mask::Strict => v1::Mask::Strict,
        Mask::Pixels => v1::Mask::Pixels,
    }
}

fn indices(indices: &[usize]) -> Vec<u32> {
    indices.iter().map(|&index| index as u32).collect()
}

fn reference_returns(returns: palr_gym_core::ReferenceReturns) -> v1::ReferenceReturns {
    v1::ReferenceReturns { random: returns.random, expert: returns.expert }
}

/// What an environment is.
pub(crate) fn environment_spec(
    spec: &EnvSpec,
    observation_dtype: v1::DataType,
) -> v1::EnvironmentSpec {
    let task = spec.task;
    v1::EnvironmentSpec {
        env_id: spec.env_id.to_string(),
        task: task.name.to_owned(),
        mask: mask(spec.env_id.mask).into(),
        frame_stack: spec.env_id.frame_stack as u32,
        observation_space: Some(box_space(spec.observation_space(), observation_dtype)),
        action_space: Some(box_space(spec.action_space(), v1::DataType::Float32)),
        max_episode_steps: task.max_episode_steps,
        frame_skip: task.frame_skip,
        physics_timestep_s: task.physics_timestep_s,
        control_timestep_s: task.control_timestep_s(),
        info_names: names(task.info_names),
        reference_returns: Some(reference_returns(task.reference_returns)),
        has_expert: experts::about(task.name).is_some(),
        mask_indices: indices(&spec.mask_indices),
        fidelity: fidelity(task.fidelity).into(),
        equals: task.equals.to_owned(),
        reset_info_names: names(task.reset_info_names),
        camera_names: names(task.camera_names),
        observation_kind: match spec.observation {
            ObservationKind::State => v1::ObservationKind::State,
            ObservationKind::Features { .. } => v1::ObservationKind::Features,
            ObservationKind::Pixels => v1::ObservationKind::Pixels,
        }
        .into(),
        feature_extractor: None,
    }
}

/// What makes features.
pub(crate) fn feature_extractor(extractor: &Extractor) -> v1::FeatureExtractor {
    let (height_px, width_px) = extractor.picture_size_px();
    v1::FeatureExtractor {
        name: extractor.name().to_owned(),
        sha256: extractor.sha256().to_owned(),
        size: extractor.size() as u32,
        height_px,
        width_px,
    }
}

/// What draws pictures; `None` until something was drawn.
pub(crate) fn opengl() -> Option<v1::OpenGl> {
    gl_info().map(|info| v1::OpenGl {
        library: info.library.to_owned(),
        renderer: info.renderer,
        version: info.version,
    })
}

/// What a task is.
pub(crate) fn task(task: &dyn Task) -> v1::Task {
    let spec = task.spec();
    v1::Task {
        name: spec.name.to_owned(),
        description: spec.description.to_owned(),
        equals: spec.equals.to_owned(),
        full_observation_size: spec.observation.len() as u32,
        action_size: spec.action_names.len() as u32,
        max_episode_steps: spec.max_episode_steps,
        masks: spec
            .masks()
            .map(|value| v1::TaskMask {
                mask: mask(value).into(),
                indices: indices(&spec.mask_indices(value)),
            })
            .collect(),
        reference_returns: Some(reference_returns(spec.reference_returns)),
        expert: experts::about(spec.name).map(|about| v1::Expert {
            sha256: about.sha256,
            card_return: about.card_return,
            model_card: about.model_card.to_owned(),
        }),
        fidelity_profiles: Fidelity::ALL
            .into_iter()
            .flat_map(tasks::tasks)
            .map(|task| task.spec())
            .filter(|profile| profile.name == spec.name)
            .map(|profile| v1::FidelityProfile {
                fidelity: fidelity(profile.fidelity).into(),
                id_suffix: profile.fidelity.suffix().to_owned(),
                equals: profile.equals.to_owned(),
                full_observation_size: profile.observation.len() as u32,
            })
            .collect(),
    }
}

/// An enum number that the generated code knows, or an error that names the field.
fn known<T: TryFrom<i32>>(
    got: i32,
    field: &'static str,
    want: &'static str,
) -> Result<T, ServerError> {
    T::try_from(got).map_err(|_| ServerError::UnknownEnum { field, got, want })
}

pub(crate) fn autoreset_mode(value: i32) -> Result<AutoresetMode, ServerError> {
    let want = "NEXT_STEP, SAME_STEP or DISABLED";
    Ok(match known(value, "autoreset_mode", want)? {
        v1::AutoresetMode::Unspecified | v1::AutoresetMode::NextStep => AutoresetMode::NextStep,
        v1::AutoresetMode::SameStep => AutoresetMode::SameStep,
        v1::AutoresetMode::Disabled => AutoresetMode::Disabled,
    })
}

pub(crate) fn out_of_bounds(value: i32) -> Result<OutOfBounds, ServerError> {
    Ok(match known(value, "out_of_bounds", "REJECT, CLIP or RAW")? {
        v1::OutOfBounds::Unspecified | v1::OutOfBounds::Reject => OutOfBounds::Reject,
        v1::OutOfBounds::Clip => OutOfBounds::Clip,
        v1::OutOfBounds::Raw => OutOfBounds::Raw,
    })
}

/// What is unset keeps its default.
pub(crate) fn scene_options(options: v1::SceneOptions) -> Result<SceneOptions, ServerError> {
    let default = SceneOptions::default();
    Ok(SceneOptions {
        lead_car_probability: options.lead_car_probability.unwrap_or(default.lead_car_probability),
        vehicles: options.vehicles.unwrap_or(default.vehicles),
        weather: match known(options.weather, "scene_options.weather", "FIXED or RANDOM")? {
            v1::Weather::Unspecified | v1::Weather::Fixed => WeatherMode::Fixed,
            v1::Weather::Random => WeatherMode::Random,
        },
    })
}

pub(crate) fn image_format(value: i32) -> Result<ImageFormat, ServerError> {
    Ok(match known(value, "format", "PNG or RAW_RGB")? {
        v1::ImageFormat::Unspecified | v1::ImageFormat::Png => ImageFormat::Png,
        v1::ImageFormat::RawRgb => ImageFormat::RawRgb,
    })
}

pub(crate) fn pictures(pictures: Pictures) -> v1::RenderResponse {
    match pictures {
        Pictures::Png(files) => v1::RenderResponse {
            png: files.into_iter().map(Bytes::from).collect(),
            ..v1::RenderResponse::default()
        },
        Pictures::RawRgb { count, height_px, width_px, rgb } => v1::RenderResponse {
            rgb: Some(v1::Tensor {
                dtype: v1::DataType::Uint8.into(),
                shape: vec![count as i64, i64::from(height_px), i64::from(width_px), 3],
                data: rgb.into(),
            }),
            ..v1::RenderResponse::default()
        },
    }
}

/// What a session's options are called on the wire.
pub(crate) fn options(options: VectorOptions) -> (v1::AutoresetMode, v1::OutOfBounds) {
    let autoreset_mode = match options.autoreset_mode {
        AutoresetMode::NextStep => v1::AutoresetMode::NextStep,
        AutoresetMode::SameStep => v1::AutoresetMode::SameStep,
        AutoresetMode::Disabled => v1::AutoresetMode::Disabled,
    };
    let out_of_bounds = match options.out_of_bounds {
        OutOfBounds::Reject => v1::OutOfBounds::Reject,
        OutOfBounds::Clip => v1::OutOfBounds::Clip,
        OutOfBounds::Raw => v1::OutOfBounds::Raw,
    };
    (autoreset_mode, out_of_bounds)
}

pub(crate) fn action_mode(value: i32) -> Result<ActionMode, ServerError> {
    Ok(match known(value, "action_mode", "DETERMINISTIC or SAMPLED")? {
        v1::ActionMode::Unspecified | v1::ActionMode::Deterministic => ActionMode::Deterministic,
        v1::ActionMode::Sampled => ActionMode::Sampled,
    })
}

pub(crate) fn policy(policy: Option<v1::Policy>) -> Result<PolicyChoice, ServerError> {
    match policy.and_then(|policy| policy.policy) {
        Some(v1::policy::Policy::Random(_)) => Ok(PolicyChoice::Random),
        Some(v1::policy::Policy::Expert(_)) => Ok(PolicyChoice::Expert),
        Some(v1::policy::Policy::Onnx(model)) => Ok(PolicyChoice::Onnx(model)),
        None => Err(ServerError::Missing { field: "policy", want: "random, expert or onnx" }),
    }
}

pub(crate) fn amount(
    amount: Option<v1::collect_request::Amount>,
    max_transitions: u64,
    max_episodes: u32,
) -> Result<Amount, ServerError> {
    match amount {
        None => Err(ServerError::Missing { field: "amount", want: "transitions or episodes" }),
        Some(v1::collect_request::Amount::Transitions(got)) => {
            in_range("transitions", got, max_transitions).map(Amount::Transitions)
        }
        Some(v1::collect_request::Amount::Episodes(got)) => {
            in_range("episodes", u64::from(got), u64::from(max_episodes))?;
            Ok(Amount::Episodes(got))
        }
    }
}

/// `got` if it is within 1 to `max`.
pub(crate) fn in_range(field: &'static str, got: u64, max: u64) -> Result<u64, ServerError> {
    if (1..=max).contains(&got) {
        Ok(got)
    } else {
        Err(ServerError::OutOfRange { field, got, min: 1, max })
    }
}

pub(crate) fn episode_result(episode: &EpisodeResult) -> v1::EvaluateResponse {
    let EpisodeResult {
        index,
        seed,
        episode_return,
        normalized_score,
        length,
        terminated,
        truncated,
    } = *episode;
    v1::EvaluateResponse {
        response: Some(v1::evaluate_response::Response::Episode(v1::EpisodeResult {
            index,
            seed,
            episode_return,
            normalized_score,
            length,
            terminated,
            truncated,
        })),
    }
}

pub(crate) fn evaluation_summary(summary: &EvaluationSummary) -> v1::EvaluateResponse {
    let (low, high) = summary.score_interquartile_mean_interval;
    v1::EvaluateResponse {
        response: Some(v1::evaluate_response::Response::Summary(v1::EvaluationSummary {
            episodes: summary.episodes,
            return_mean: summary.return_mean,
            return_standard_error: summary.return_standard_error,
            score_mean: summary.score_mean,
            score_standard_error: summary.score_standard_error,
            score_interquartile_mean: summary.score_interquartile_mean,
            score_interquartile_mean_low: low,
            score_interquartile_mean_high: high,
            length_mean: summary.length_mean,
            steps: summary.steps,
            wall_time_s: summary.wall_time_s,
            num_envs: summary.num_envs as u32,
        })),
    }
}

pub(crate) fn episode_transitions(
    spec: &EnvSpec,
    episode: &EpisodeTransitions,
) -> v1::CollectResponse {
    let length = episode.len();
    let rows = |values: &[f64]| float64(values, &[length, values.len() / length.max(1)]);
    let frames = |values: &[f64]| match spec.observation {
        ObservationKind::Pixels => {
            let bytes: Vec<u8> = values.iter().map(|&value| value as u8).collect();
            let sizes = spec.observation_shape();
            let shape: Vec<usize> = std::iter::once(length).chain(sizes).collect();
            tensor(v1::DataType::Uint8, &bytes, &shape)
        }
        ObservationKind::State | ObservationKind::Features { .. } => rows(values),
    };
    v1::CollectResponse {
        response: Some(v1::collect_response::Response::Episode(v1::EpisodeTransitions {
            index: episode.index,
            seed: episode.seed,
            observations: Some(frames(&episode.observations)),
            actions: Some(float32(
                &episode.actions,
                &[length, episode.actions.len() / length.max(1)],
            )),
            rewards: Some(float64(&episode.rewards, &[length])),
            next_observations: Some(frames(&episode.next_observations)),
            terminated: episode.terminated,
            truncated: episode.truncated,
            cut: episode.cut,
            qpos: Some(rows(&episode.qpos)),
            qvel: Some(rows(&episode.qvel)),
            action_log_probs: (!episode.action_log_probs.is_empty())
                .then(|| float64(&episode.action_log_probs, &[length])),
        })),
    }
}
