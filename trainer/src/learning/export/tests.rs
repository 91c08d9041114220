use palr_gym_onnx::policy::{Policy, PolicyLimits};
use safetensors::SafeTensors;

use super::*;

fn policy() -> TrainedPolicy {
    let shape = PolicyShape { observation_size: 10, action_size: 3 };
    TrainedPolicy {
        shape,
        observation_statistics: Standardization {
            mean: (0..10).map(|i| i as f32 * 0.7 - 2.0).collect(),
            std: (0..10).map(|i| 0.1 + i as f32).collect(),
        },
        parameters: shape.initial_parameters(9),
    }
}

#[test]
fn onnx_runtime_computes_what_the_policy_computes() {
    let mut policy = policy();
    // One log_std beyond each bound.
    let count = policy.parameters.len();
    policy.parameters[count - 3..].copy_from_slice(&[30.0, -30.0, 0.1]);
    let observations: Vec<f32> = (0..70).map(|i| (i as f32 * 1.37).sin() * 9.0).collect();
    let want = policy.act(&observations).unwrap();
    let model = policy.to_onnx().unwrap();
    let mut runtime = Policy::load(&model, 10, 3, PolicyLimits::default()).unwrap();
    runtime.require_stochastic().unwrap();
    let got = runtime.act(&observations, 7).unwrap();
    let check = |got: &[f32], want: &[f32]| {
        assert_eq!(got.len(), want.len());
        for (got, want) in got.iter().zip(want) {
            assert!((got - want).abs() < 1e-5, "{got} {want}");
        }
    };
    check(&got.action, &want.action);
    check(&got.mean.unwrap(), &want.mean);
    check(&got.log_std.unwrap(), &want.log_std);
    assert_eq!(want.log_std[..2], [2.0, -20.0]);
}

#[test]
fn safetensors_hold_every_parameter_and_the_same_bytes_each_time() {
    let policy = policy();
    let bytes = policy.to_safetensors().unwrap();
    assert_eq!(bytes, policy.to_safetensors().unwrap());
    assert_eq!(policy.to_onnx().unwrap(), policy.to_onnx().unwrap());
    let tensors = SafeTensors::deserialize(&bytes).unwrap();
    assert_eq!(tensors.tensor("encoder_1.weight").unwrap().shape(), [10, 128]);
    assert_eq!(tensors.tensor("log_std.bias").unwrap().shape(), [3]);
    let count: usize = tensors.iter().map(|(_, view)| view.data().len() / 4).sum();
    assert_eq!(count, policy.parameters.len() + 20);
}
