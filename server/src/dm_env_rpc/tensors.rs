//! Specs and observations going out; actions coming in.

use std::collections::BTreeMap;

use palr_gym_core::{BoxSpace, EnvSpec};
use palr_gym_proto::dm_env_rpc::v1::tensor::{DoubleArray, FloatArray, Payload};
use palr_gym_proto::dm_env_rpc::v1::tensor_spec::{Value, value};
use palr_gym_proto::dm_env_rpc::v1::{ActionObservationSpecs, DataType, Tensor, TensorSpec};

use super::error::DmEnvRpcError;

/// The only action.
pub(super) const ACTION_UID: u64 = 1;
/// The masked, stacked observation.
pub(super) const OBSERVATION_UID: u64 = 1;
/// The reward of the step.
pub(super) const REWARD_UID: u64 = 2;

/// What a connection that joins is told. The names are those that remote-gym looks for.
pub(super) fn specs(spec: &EnvSpec) -> ActionObservationSpecs {
    let action_space = spec.action_space();
    let action = TensorSpec {
        name: "action".into(),
        shape: vec![spec.action_size() as i32],
        dtype: DataType::Float.into(),
        min: Some(float_bound(&action_space.low)),
        max: Some(float_bound(&action_space.high)),
    };
    let BoxSpace { low, high, .. } = spec.observation_space();
    let observation = TensorSpec {
        name: "observation".into(),
        shape: vec![spec.observation_size() as i32],
        dtype: DataType::Double.into(),
        min: Some(double_bound(&low)),
        max: Some(double_bound(&high)),
    };
    let reward = TensorSpec {
        name: "reward".into(),
        shape: vec![],
        dtype: DataType::Double.into(),
        min: None,
        max: None,
    };
    ActionObservationSpecs {
        actions: BTreeMap::from([(ACTION_UID, action)]),
        observations: BTreeMap::from([(OBSERVATION_UID, observation), (REWARD_UID, reward)]),
    }
}

/// One bound where all are equal.
fn bounds(values: &[f64]) -> &[f64] {
    let all_equal = values.windows(2).all(|pair| pair[0] == pair[1]);
    if all_equal { &values[..values.len().min(1)] } else { values }
}

fn float_bound(values: &[f64]) -> Value {
    let array = bounds(values).iter().map(|&bound| bound as f32).collect();
    Value { payload: Some(value::Payload::Floats(FloatArray { array })) }
}

fn double_bound(values: &[f64]) -> Value {
    Value { payload: Some(value::Payload::Doubles(DoubleArray { array: bounds(values).to_vec() })) }
}

/// Checks what is asked for, before anything is changed.
pub(super) fn check_requested(uids: &[u64]) -> Result<(), DmEnvRpcError> {
    match uids.iter().find(|&&uid| uid != OBSERVATION_UID && uid != REWARD_UID) {
        Some(&uid) => Err(DmEnvRpcError::UnknownObservation { uid }),
        None => Ok(()),
    }
}

/// What was asked for of an observation and a reward.
pub(super) fn observations(
    uids: &[u64],
    observation: &[f64],
    reward: f64,
) -> BTreeMap<u64, Tensor> {
    let mut tensors = BTreeMap::new();
    if uids.contains(&OBSERVATION_UID) {
        let shape = vec![observation.len() as i32];
        tensors.insert(OBSERVATION_UID, doubles(observation.to_vec(), shape));
    }
    if uids.contains(&REWARD_UID) {
        tensors.insert(REWARD_UID, doubles(vec![reward], vec![]));
    }
    tensors
}

fn doubles(array: Vec<f64>, shape: Vec<i32>) -> Tensor {
    Tensor { payload: Some(Payload::Doubles(DoubleArray { array })), shape }
}

/// The action of a step: `[size]` float32, or a single one for all entries. Without one, zeros.
/// Bounds are the simulation's business.
pub(super) fn action(
    actions: &BTreeMap<u64, Tensor>,
    size: usize,
) -> Result<Vec<f32>, DmEnvRpcError> {
    if let Some(&uid) = actions.keys().find(|&&uid| uid != ACTION_UID) {
        return Err(DmEnvRpcError::UnknownAction { uid });
    }
    let Some(tensor) = actions.get(&ACTION_UID) else { return Ok(vec![0.0; size]) };
    let values = match &tensor.payload {
        Some(Payload::Floats(floats)) => &floats.array,
        payload => return Err(DmEnvRpcError::ActionType { got: type_name(payload.as_ref()) }),
    };
    let is_shaped = match *tensor.shape {
        // A scalar stands for all entries.
        [] => values.len() == 1,
        [entries] => entries == -1 || usize::try_from(entries) == Ok(size),
        _ => false,
    };
    match **values {
        [value] if is_shaped => Ok(vec![value; size]),
        _ if is_shaped && values.len() == size => Ok(values.clone()),
        _ => Err(DmEnvRpcError::ActionShape {
            // As much of a stranger's shape as is worth quoting.
            shape: tensor.shape.iter().copied().take(8).collect(),
            elements: values.len(),
            size,
        }),
    }
}

/// The protocol's name of a payload.
pub(super) fn type_name(payload: Option<&Payload>) -> &'static str {
    match payload {
        None => "none",
        Some(Payload::Floats(_)) => "floats",
        Some(Payload::Doubles(_)) => "doubles",
        Some(Payload::Int8s(_)) => "int8s",
        Some(Payload::Int32s(_)) => "int32s",
        Some(Payload::Int64s(_)) => "int64s",
        Some(Payload::Uint8s(_)) => "uint8s",
        Some(Payload::Uint32s(_)) => "uint32s",
        Some(Payload::Uint64s(_)) => "uint64s",
        Some(Payload::Bools(_)) => "bools",
        Some(Payload::Strings(_)) => "strings",
        Some(Payload::Protos(_)) => "protos",
    }
}

/// Elements of a payload.
pub(super) fn count(payload: Option<&Payload>) -> usize {
    match payload {
        None => 0,
        Some(Payload::Floats(values)) => values.array.len(),
        Some(Payload::Doubles(values)) => values.array.len(),
        Some(Payload::Int8s(values)) => values.array.len(),
        Some(Payload::Int32s(values)) => values.array.len(),
        Some(Payload::Int64s(values)) => values.array.len(),
        Some(Payload::Uint8s(values)) => values.array.len(),
        Some(Payload::Uint32s(values)) => values.array.len(),
        Some(Payload::Uint64s(values)) => values.array.len(),
        Some(Payload::Bools(values)) => values.array.len(),
        Some(Payload::Strings(values)) => values.array.len(),
        Some(Payload::Protos(values)) => values.array.len(),
    }
}
