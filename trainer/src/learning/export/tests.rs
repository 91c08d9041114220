use palr_gym_onnx::policy::{Policy, PolicyLimits};
use safetensors::SafeTensors;

use super::*;
use crate::learning::architecture::Kind;
use crate::learning::config::PrimeJunction;
use crate::learning::network::{Initialization, Network};

const SIZES: (usize, usize, usize) = (10, 5, 3);

/// Of every kind.
fn policies() -> Vec<TrainedPolicy> {
    let (observation_size, frame_size, action_size) = SIZES;
    [
        Kind::Plain,
        Kind::Rap,
        Kind::Primenet(PrimeJunction::Input),
        Kind::Primenet(PrimeJunction::Representation),
        Kind::Primenet(PrimeJunction::Hidden),
        Kind::Sampled(3),
        Kind::Transformer,
    ]
    .map(|kind| {
        let architecture = Architecture { observation_size, frame_size, action_size, kind };
        let networks = architecture.networks();
        let parameters = networks.into_iter().zip(1..).flat_map(|((name, layers), number)| {
            Network::new(name, layers, Initialization::Uniform, 9, number).parameters
        });
        TrainedPolicy {
            architecture,
            observation_statistics: Standardization {
                mean: (0..10).map(|i| i as f32 * 0.7 - 2.0).collect(),
                std: (0..10).map(|i| 0.1 + i as f32).collect(),
            },
            parameters: parameters.collect(),
        }
    })
    .into()
}

fn check(got: &[f32], want: &[f32]) {
    assert_eq!(got.len(), want.len());
    for (got, want) in got.iter().zip(want) {
        assert!((got - want).abs() < 1e-5, "{got} {want}");
    }
}

#[test]
fn onnx_runtime_computes_what_policies_of_every_kind_compute() {
    let observations: Vec<f32> = (0..70).map(|i| (i as f32 * 1.37).sin() * 9.0).collect();
    for policy in policies() {
        let want = policy.act(&observations).unwrap();
        let model = policy.to_onnx().unwrap();
        let mut runtime = Policy::load(&model, 10, 3, PolicyLimits::default()).unwrap();
        runtime.require_stochastic().unwrap();
        let got = runtime.act(&observations, 7).unwrap();
        check(&got.action, &want.action);
        check(&got.mean.unwrap(), &want.mean);
        check(&got.log_std.unwrap(), &want.log_std);
        // No kind ignores what it is given.
        let other: Vec<f32> = observations.iter().map(|x| x + 0.5).collect();
        assert_ne!(policy.act(&other).unwrap().mean, want.mean, "{:?}", policy.architecture);
    }
}

#[test]
fn log_std_is_clipped_in_onnx_too() {
    let mut policy = policies().swap_remove(0);
    // One log_std beyond each bound.
    let count = policy.parameters.len();
    policy.parameters[count - 3..].copy_from_slice(&[30.0, -30.0, 0.1]);
    let observations: Vec<f32> = (0..70).map(|i| (i as f32 * 1.37).sin() * 9.0).collect();
    let want = policy.act(&observations).unwrap();
    let model = policy.to_onnx().unwrap();
    let mut runtime = Policy::load(&model, 10, 3, PolicyLimits::default()).unwrap();
    runtime.require_stochastic().unwrap();
    let got = runtime.act(&observations, 7).unwrap();
    check(&got.log_std.unwrap(), &want.log_std);
    assert_eq!(want.log_std[..2], [2.0, -20.0]);
}

#[test]
fn safetensors_hold_every_parameter_and_the_same_bytes_each_time() {
    for policy in policies() {
        let bytes = policy.to_safetensors().unwrap();
        assert_eq!(bytes, policy.to_safetensors().unwrap());
        assert_eq!(policy.to_onnx().unwrap(), policy.to_onnx().unwrap());
        let tensors = SafeTensors::deserialize(&bytes).unwrap();
        assert_eq!(tensors.tensor("log_std.bias").unwrap().shape(), [3]);
        let (name, rows) = match policy.architecture.kind {
            Kind::Plain => ("encoder_1.weight", 10),
            Kind::Rap => ("memory.memory_1.weight", 10),
            Kind::Primenet(_) => ("prime.encoder_1.weight", 5),
            Kind::Transformer => ("state.weight", 5),
            Kind::Sampled(samples) => ("noise.samples.weight", samples),
        };
        assert_eq!(tensors.tensor(name).unwrap().shape()[0], rows);
        let count: usize = tensors.iter().map(|(_, view)| view.data().len() / 4).sum();
        assert_eq!(count, policy.parameters.len() + 20);
        let short = TrainedPolicy { parameters: vec![0.0; 5], ..policy };
        assert!(short.to_onnx().is_err() && short.act(&[0.0; 10]).is_err());
    }
}
