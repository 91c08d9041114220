use std::sync::Arc;

use palr_gym_core::random::Generator;

use super::*;
use crate::learning::data::TrainingSet;
use crate::learning::network::values;
use crate::learning::policy_net::PolicyShape;
use crate::learning::weights::{KernelConfig, WeightMatrix};

/// M as a square tensor.
fn square(weights: &WeightMatrix, device: &Device) -> Tensor<2> {
    let (n, diagonal) = (weights.n(), weights.diagonal());
    let entries = (0..n * n).map(|at| match (at / n, at % n) {
        (i, j) if i == j => diagonal[i],
        (i, j) => weights.below(i.max(j))[i.min(j)],
    });
    tensor(entries.collect(), n, device)
}

/// α ⟨K_φ, M⟩ / n, written so that autodiff goes through the n × n kernel.
fn through_the_kernel(phi: Tensor<2>, weights: &WeightMatrix, alpha: f64) -> Tensor<1> {
    let norms = (phi.clone() * phi.clone()).sum_dim(1);
    let products = phi.clone().matmul(phi.clone().transpose());
    let distances = norms.clone() + norms.transpose() - products.mul_scalar(2.0);
    let weights_square = square(weights, &phi.device());
    (distances.neg().exp() * weights_square).sum().mul_scalar(alpha / weights.n() as f64)
}

#[test]
fn the_surrogate_has_the_gradient_of_autodiff_through_the_kernel() {
    let n = 48;
    let mut generator = Generator::from_seed(5);
    let mut draw = |count: usize| -> Vec<f32> {
        (0..count).map(|_| generator.standard_normal() as f32).collect()
    };
    let past: Vec<f32> = draw(n * 2).iter().map(|x| x.tanh()).collect();
    let given = past.iter().zip(draw(n * 2)).map(|(y, e)| (y + 0.3 * e).tanh()).collect();
    let set = TrainingSet::new(&draw(n * 4), 4, given, past, 2).unwrap();
    let rows: Vec<usize> = (0..n).collect();
    let batch = set.batch(&rows);
    let (past, given) = set.hscic_actions(&rows, true);
    let config = KernelConfig { ridge: 1e-5, bandwidth_sq: 1.0 };
    let matrix = Arc::new(WeightMatrix::new(&past, &given, 2, config).unwrap());
    let own = StepWeights { weights: Arc::clone(&matrix), observations: None };
    let config = PalrConfig::default();

    let constants = Device::flex();
    let device = constants.clone().autodiff();
    let shape = PolicyShape::plain(4, 2);
    let policy = PolicyNet::new(shape, &shape.network(0).parameters, &device).unwrap();
    let tensors = batch.tensors(&constants);
    let (got, report) = loss(&policy, &tensors, &own, &config, &constants).unwrap();
    let got_gradient = policy.gradient(&got).unwrap();

    let output = policy.forward(tensors.observations.clone());
    let (likelihood, _) = likelihood::of_batch(&output, &tensors).unwrap();
    let penalty = through_the_kernel(output.representation, &matrix, 10.0);
    let value = values(penalty.clone().inner()).unwrap()[0];
    let want_gradient = policy.gradient(&(likelihood + penalty)).unwrap();

    let hscic = report.hscic.unwrap();
    assert!((hscic * 10.0 - f64::from(value)).abs() < 1e-4 * f64::from(value));
    let norm = |x: &[f32]| x.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt();
    let distance = |a: &[f32], b: &[f32]| {
        let difference: Vec<f32> = a.iter().zip(b).map(|(a, b)| a - b).collect();
        norm(&difference)
    };
    let scale = norm(&want_gradient);
    assert!(distance(&got_gradient, &want_gradient) < 2e-5 * scale);
    // The penalty is not lost in the likelihood.
    let output = policy.forward(tensors.observations.clone());
    let (plain, _) = likelihood::of_batch(&output, &tensors).unwrap();
    assert!(distance(&policy.gradient(&plain).unwrap(), &want_gradient) > 1e-2 * scale);

    // The same rows given as rows of a pool.
    let pooled = StepWeights { weights: matrix, observations: Some(batch.observations.clone()) };
    let (pooled, _) = loss(&policy, &tensors, &pooled, &config, &constants).unwrap();
    assert!(distance(&policy.gradient(&pooled).unwrap(), &got_gradient) < 2e-5 * scale);
}
