//! Messages: decoded or refused, and believed only after a check.

use bytes::Bytes;
use palr_gym_proto::dm_env_rpc::v1 as dm;
use palr_gym_proto::v1;
use palr_gym_server::convert;
use prost::Message;

type Decode = fn(Bytes);

/// Every message that a client can send; the first byte of an input picks one.
const MESSAGES: [Decode; 12] = [
    decode_step_stream,
    again::<v1::OpenSessionRequest>,
    again::<v1::CloseSessionRequest>,
    again::<v1::ResetRequest>,
    decode_step,
    again::<v1::EvaluateRequest>,
    again::<v1::CollectRequest>,
    decode_leakage,
    again::<v1::GetEnvironmentSpecRequest>,
    again::<v1::RestoreSnapshotRequest>,
    again::<v1::OpenSnapshotRequest>,
    again::<dm::EnvironmentRequest>,
];

/// Environments and entries of an action of the session for which steps are checked.
const NUM_ENVS: usize = 2;
const ACTION_SIZE: usize = 3;
const MAX_SAMPLES: usize = 64;

/// See the module.
pub fn run(data: &[u8]) {
    let Some((kind, data)) = data.split_first() else { return };
    MESSAGES[usize::from(*kind) % MESSAGES.len()](Bytes::copy_from_slice(data));
}

/// What decodes, encodes again to bytes that mean the same.
fn again<M: Message + Default>(data: Bytes) {
    decoded::<M>(data);
}

fn decoded<M: Message + Default>(data: Bytes) -> Option<M> {
    let message = M::decode(data).ok()?;
    let bytes = message.encode_to_vec();
    assert_eq!(bytes.len(), message.encoded_len());
    let second = M::decode(Bytes::from(bytes.clone())).expect("our own bytes");
    // Bytes and not messages: NaN is not equal to itself.
    assert_eq!(second.encode_to_vec(), bytes);
    Some(message)
}

fn check_step(step: &v1::StepRequest) {
    if let Ok(actions) = convert::actions(step.actions.as_ref(), NUM_ENVS, ACTION_SIZE) {
        let steps = actions.open_loop.unwrap_or(1);
        assert_eq!(actions.values.len(), steps * NUM_ENVS * ACTION_SIZE);
    }
}

fn decode_step(data: Bytes) {
    if let Some(step) = decoded::<v1::StepRequest>(data) {
        check_step(&step);
    }
}

fn decode_step_stream(data: Bytes) {
    use v1::step_stream_request::Request;
    if let Some(Request::Step(step)) =
        decoded::<v1::StepStreamRequest>(data).and_then(|request| request.request)
    {
        check_step(&step);
    }
}

fn decode_leakage(data: Bytes) {
    let Some(request) = decoded::<v1::EstimateLeakageRequest>(data) else { return };
    for tensor in [&request.past_actions, &request.given_actions] {
        if let Ok(matrix) = convert::matrix(tensor.as_ref(), "past_actions", MAX_SAMPLES) {
            assert!(matrix.nrows() <= MAX_SAMPLES);
        }
    }
}

fn tensor(dtype: v1::DataType, shape: &[i64], bytes: usize) -> Option<v1::Tensor> {
    let data = (0..bytes).map(|i| i as u8).collect();
    Some(v1::Tensor { dtype: dtype.into(), shape: shape.to_vec(), data })
}

/// One valid message of each kind.
#[must_use]
pub fn corpus() -> Vec<Vec<u8>> {
    use v1::step_stream_request::Request;
    let session_id = || "67e55044-10b1-426f-9247-bb680e5fe0c8".to_owned();
    let step = v1::StepRequest {
        session_id: session_id(),
        actions: tensor(v1::DataType::Float32, &[2, 3], 24),
    };
    let reset = v1::ResetRequest {
        session_id: session_id(),
        seeds: vec![1, u64::MAX],
        env_indices: vec![1],
    };
    let policy = |policy| Some(v1::Policy { policy: Some(policy) });
    let open = v1::OpenSessionRequest {
        env_id: "hopper-w2".into(),
        num_envs: Some(4),
        autoreset_mode: 2,
        out_of_bounds: 1,
        ..v1::OpenSessionRequest::default()
    };
    let evaluate = v1::EvaluateRequest {
        env_id: "ant".into(),
        policy: policy(v1::policy::Policy::Onnx(Bytes::from_static(b"\x08\x07onnx"))),
        episodes: Some(3),
        ..v1::EvaluateRequest::default()
    };
    let collect = v1::CollectRequest {
        env_id: "hopper".into(),
        policy: policy(v1::policy::Policy::Expert(v1::ExpertPolicy {})),
        ..v1::CollectRequest::default()
    };
    let leakage = v1::EstimateLeakageRequest {
        past_actions: tensor(v1::DataType::Float64, &[4, 2], 64),
        given_actions: tensor(v1::DataType::Float32, &[4, 2], 32),
        episode_lengths: vec![2, 2],
        ..v1::EstimateLeakageRequest::default()
    };
    let restore = v1::RestoreSnapshotRequest {
        session_id: session_id(),
        snapshot: Bytes::from_static(b"PALRSNAP"),
    };
    let snapshot = v1::OpenSnapshotRequest { snapshot: Bytes::from_static(b"PALRSNAP") };
    let stream = |request| v1::StepStreamRequest { request: Some(request) };
    let messages: [(u8, Vec<u8>); 13] = [
        (0, stream(Request::Step(step.clone())).encode_to_vec()),
        (0, stream(Request::Reset(reset.clone())).encode_to_vec()),
        (1, open.encode_to_vec()),
        (2, v1::CloseSessionRequest { session_id: session_id() }.encode_to_vec()),
        (3, reset.encode_to_vec()),
        (4, step.encode_to_vec()),
        (5, evaluate.encode_to_vec()),
        (6, collect.encode_to_vec()),
        (7, leakage.encode_to_vec()),
        (8, v1::GetEnvironmentSpecRequest { env_id: "ant-w4".into() }.encode_to_vec()),
        (9, restore.encode_to_vec()),
        (10, snapshot.encode_to_vec()),
        (11, super::dm_env_rpc::a_step().encode_to_vec()),
    ];
    messages.map(|(kind, bytes)| [vec![kind], bytes].concat()).to_vec()
}
