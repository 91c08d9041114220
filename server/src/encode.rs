//! Answers as messages, encoded on the simulation thread.

use bytes::{BufMut, Bytes, BytesMut};
use palr_gym_core::{EnvSpec, ObservationKind};
use palr_gym_proto::v1;
use palr_gym_sim::{DivergedEpisode, Divergence, StepFrame, VectorOptions};

use crate::convert;
use crate::pictures::Pictures;
use crate::session::{Encode, Standing};

/// Element type of observations on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ObservationType {
    /// As they are simulated.
    #[default]
    Float64,
    /// Rounded to nearest.
    Float32,
}

impl ObservationType {
    /// What it is called on the wire.
    #[must_use]
    pub fn dtype(self) -> v1::DataType {
        match self {
            Self::Float64 => v1::DataType::Float64,
            Self::Float32 => v1::DataType::Float32,
        }
    }
}

/// Encodes answers on the simulation thread, so that the network threads only copy bytes.
#[derive(Debug, Clone, Copy, Default)]
pub struct WireEncode {
    /// Element type of observations.
    pub observation_type: ObservationType,
}

/// The answer to a command.
#[derive(Debug)]
pub enum WireAnswer {
    /// To a reset.
    Reset(v1::ResetResponse),
    /// To a step or several.
    Step(Box<v1::StepResponse>),
    /// To the wish for pictures.
    Pictures(v1::RenderResponse),
    /// To the wish for a snapshot.
    Snapshot(Bytes),
    /// To a restore.
    Restored(v1::RestoredState),
}

/// One buffer for all arrays of an answer, each of which is then a part of it.
struct Payload<'a> {
    bytes: &'a mut BytesMut,
}

impl<'a> Payload<'a> {
    /// `capacity` bytes of `room`: the same as last time, once the arrays of then are gone.
    fn new(room: &'a mut BytesMut, capacity: usize) -> Self {
        room.reserve(capacity);
        Self { bytes: room }
    }

    fn put<T: bytemuck::NoUninit>(
        &mut self,
        dtype: v1::DataType,
        values: &[T],
        shape: Vec<i64>,
    ) -> v1::Tensor {
        self.bytes.put_slice(bytemuck::cast_slice(values));
        v1::Tensor { dtype: dtype.into(), shape, data: self.bytes.split().freeze() }
    }

    fn float64(&mut self, values: &[f64], shape: Vec<i64>) -> v1::Tensor {
        self.put(v1::DataType::Float64, values, shape)
    }

    fn boolean(&mut self, values: &[bool], shape: Vec<i64>) -> v1::Tensor {
        self.put(v1::DataType::Bool, values, shape)
    }

    fn observations(&mut self, dtype: v1::DataType, values: &[f64], shape: Vec<i64>) -> v1::Tensor {
        match dtype {
            v1::DataType::Float32 => values.iter().for_each(|&v| self.bytes.put_f32_le(v as f32)),
            // Whole numbers within 0 and 255, so nothing is lost.
            v1::DataType::Uint8 => self.bytes.extend(values.iter().map(|&value| value as u8)),
            _ => return self.float64(values, shape),
        }
        v1::Tensor { dtype: dtype.into(), shape, data: self.bytes.split().freeze() }
    }
}

impl WireEncode {
    /// What of this encoding a snapshot keeps; [`from_tag`](Self::from_tag) reads it.
    const FLOAT32_TAG: u8 = 1;

    /// The encoding that a snapshot names.
    #[must_use]
    pub fn from_tag(tag: u8) -> Option<Self> {
        match tag {
            0 => Some(Self { observation_type: ObservationType::Float64 }),
            Self::FLOAT32_TAG => Some(Self { observation_type: ObservationType::Float32 }),
            _ => None,
        }
    }

    /// Element type of observations of `spec` on the wire: pictures are bytes in any case.
    #[must_use]
    pub fn observation_dtype(self, spec: &EnvSpec) -> v1::DataType {
        match spec.observation {
            ObservationKind::Pixels => v1::DataType::Uint8,
            ObservationKind::State | ObservationKind::Features { .. } => {
                self.observation_type.dtype()
            }
        }
    }

    fn observation_bytes(self, spec: &EnvSpec) -> usize {
        let element = match self.observation_dtype(spec) {
            v1::DataType::Uint8 => size_of::<u8>(),
            v1::DataType::Float32 => size_of::<f32>(),
            _ => size_of::<f64>(),
        };
        spec.observation_size() * element
    }

    /// Bytes of arrays in the answer to one step, final observations included.
    #[must_use]
    pub fn step_bytes(self, spec: &EnvSpec, num_envs: usize) -> usize {
        let observation = self.observation_bytes(spec);
        let numbers = 1 + spec.task.info_names.len() + spec.task.reset_info_names.len();
        num_envs * (2 * observation + numbers * size_of::<f64>() + 2)
    }

    fn steps(
        self,
        spec: &EnvSpec,
        frame: &StepFrame,
        shape: &[usize],
        room: &mut BytesMut,
    ) -> WireAnswer {
        let shape_with =
            |last: &[usize]| -> Vec<i64> { shape.iter().chain(last).map(|&n| n as i64).collect() };
        let capacity = frame.rewards.len() * self.observation_bytes(spec)
            + (frame.rewards.len() + frame.info.len()) * size_of::<f64>()
            + frame.terminated.len()
            + frame.truncated.len();
        let mut payload = Payload::new(room, capacity);
        let mut answer = v1::StepResponse {
            observations: Some(payload.observations(
                self.observation_dtype(spec),
                &frame.observations,
                shape_with(&spec.observation_shape()),
            )),
            rewards: Some(payload.float64(&frame.rewards, shape_with(&[]))),
            terminated: Some(payload.boolean(&frame.terminated, shape_with(&[]))),
            truncated: Some(payload.boolean(&frame.truncated, shape_with(&[]))),
            info: Some(payload.float64(&frame.info, shape_with(&[spec.task.info_names.len()]))),
            ..v1::StepResponse::default()
        };
        if !frame.final_observations.is_empty() {
            self.add_final(spec, frame, &mut answer);
        }
        answer.diverged = frame.diverged.iter().map(diverged).collect();
        WireAnswer::Step(Box::new(answer))
    }

    /// Adds what SAME_STEP delivers beside the new episodes.
    fn add_final(self, spec: &EnvSpec, frame: &StepFrame, answer: &mut v1::StepResponse) {
        let ended: Vec<usize> = (0..frame.rewards.len())
            .filter(|&row| frame.terminated[row] || frame.truncated[row])
            .collect();
        if ended.is_empty() {
            return;
        }
        let rows = |values: &[f64], size: usize| -> Vec<f64> {
            ended.iter().flat_map(|row| &values[row * size..(row + 1) * size]).copied().collect()
        };
        let (size, reset_size) = (spec.observation_size(), spec.task.reset_info_names.len());
        let shape = |sizes: &[usize]| shape_of(ended.len(), sizes);
        let observations = rows(&frame.final_observations, size);
        let mut room = BytesMut::new();
        let mut payload = Payload::new(&mut room, 0);
        let (dtype, shape_of_one) = (self.observation_dtype(spec), spec.observation_shape());
        answer.final_observations =
            Some(payload.observations(dtype, &observations, shape(&shape_of_one)));
        if reset_size > 0 {
            let reset_info = rows(&frame.reset_info, reset_size);
            answer.reset_info = Some(payload.float64(&reset_info, shape(&[reset_size])));
        }
    }

    fn standing(self, spec: &EnvSpec, observations: &[f64]) -> v1::Tensor {
        let count = observations.len() / spec.observation_size();
        let mut room = BytesMut::new();
        let mut payload = Payload::new(&mut room, count * self.observation_bytes(spec));
        let shape = shape_of(count, &spec.observation_shape());
        payload.observations(self.observation_dtype(spec), observations, shape)
    }

    /// The state of a session that was restored or opened from a snapshot.
    #[must_use]
    pub fn restored_state(
        self,
        spec: &EnvSpec,
        options: VectorOptions,
        standing: &Standing,
    ) -> v1::RestoredState {
        let (autoreset_mode, out_of_bounds) = convert::options(options);
        let num_envs = standing.is_over.len();
        v1::RestoredState {
            was_reset: standing.was_reset,
            observations: Some(self.standing(spec, &standing.observations)),
            is_over: Some(convert::boolean(&standing.is_over, &[num_envs])),
            autoreset_mode: autoreset_mode.into(),
            out_of_bounds: out_of_bounds.into(),
        }
    }
}

/// `[count, ...sizes]`.
fn shape_of(count: usize, sizes: &[usize]) -> Vec<i64> {
    std::iter::once(&count).chain(sizes).map(|&size| size as i64).collect()
}

fn diverged(episode: &DivergedEpisode) -> v1::DivergedEpisode {
    let reason = match episode.divergence {
        Divergence::Inertia => v1::Divergence::Inertia,
        Divergence::ContactsFull => v1::Divergence::ContactsFull,
        Divergence::ConstraintsFull => v1::Divergence::ConstraintsFull,
        Divergence::BadPosition => v1::Divergence::BadPosition,
        Divergence::BadVelocity => v1::Divergence::BadVelocity,
        Divergence::BadAcceleration => v1::Divergence::BadAcceleration,
        Divergence::BadControl => v1::Divergence::BadControl,
        Divergence::NotFinite => v1::Divergence::NotFinite,
        Divergence::EngineError => v1::Divergence::EngineError,
        Divergence::Unseen => v1::Divergence::Unseen,
    };
    v1::DivergedEpisode {
        step: episode.step as u32,
        env_index: episode.env_index as u32,
        reason: reason.into(),
    }
}

impl Encode for WireEncode {
    type Answer = WireAnswer;

    fn reset(&self, spec: &EnvSpec, standing: &Standing) -> WireAnswer {
        let size = spec.task.reset_info_names.len();
        let num_envs = standing.is_over.len();
        WireAnswer::Reset(v1::ResetResponse {
            observations: Some(self.standing(spec, &standing.observations)),
            info: (size > 0).then(|| convert::float64(&standing.reset_info, &[num_envs, size])),
        })
    }

    fn step(&self, spec: &EnvSpec, frame: &StepFrame, room: &mut BytesMut) -> WireAnswer {
        self.steps(spec, frame, &[frame.rewards.len()], room)
    }

    fn open_loop(&self, spec: &EnvSpec, frame: &StepFrame) -> WireAnswer {
        let shape = [frame.steps, frame.rewards.len() / frame.steps];
        self.steps(spec, frame, &shape, &mut BytesMut::new())
    }

    fn pictures(&self, pictures: Pictures) -> WireAnswer {
        WireAnswer::Pictures(convert::pictures(pictures))
    }

    fn tag(&self) -> u8 {
        match self.observation_type {
            ObservationType::Float64 => 0,
            ObservationType::Float32 => Self::FLOAT32_TAG,
        }
    }

    fn snapshot(&self, snapshot: Vec<u8>) -> WireAnswer {
        WireAnswer::Snapshot(snapshot.into())
    }

    fn restored(&self, spec: &EnvSpec, options: VectorOptions, standing: &Standing) -> WireAnswer {
        WireAnswer::Restored(self.restored_state(spec, options, standing))
    }
}
