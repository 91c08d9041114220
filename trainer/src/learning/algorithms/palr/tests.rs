use burn::tensor::Tensor;
use palr_gym_core::random::Generator;

use super::*;
use crate::learning::data::TrainingSet;
use crate::learning::policy_net::PolicyShape;
use crate::learning::weights::KernelConfig;

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
    let weights = WeightMatrix::new(&past, &given, 2, config).unwrap();
    let regularizer =
        Regularizer { weights: &weights, observations: None, alpha: 10.0, bandwidth_sq: 1.0 };

    let device = Device::flex().autodiff();
    let shape = PolicyShape { observation_size: 4, action_size: 2 };
    let policy = PolicyNet::new(shape, &shape.initial_parameters(0), &device).unwrap();
    let got = loss(&policy, &batch, regularizer, &device).unwrap();
    let got_gradient = policy.gradient(&got.tensor).unwrap();

    let (likelihood, output) = bc::loss_and_tensors(&policy, &batch, &device).unwrap();
    let penalty = through_the_kernel(output.representation, &weights, 10.0);
    let value = values(penalty.clone().inner()).unwrap()[0];
    let want_gradient = policy.gradient(&(likelihood.tensor + penalty)).unwrap();

    assert!((got.hscic.unwrap() * 10.0 - f64::from(value)).abs() < 1e-4 * f64::from(value));
    let norm = |x: &[f32]| x.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt();
    let difference: Vec<f32> =
        got_gradient.iter().zip(&want_gradient).map(|(a, b)| a - b).collect();
    assert!(norm(&difference) < 2e-5 * norm(&want_gradient), "{}", norm(&difference));
    // The penalty is not lost in the likelihood.
    let plain = policy.gradient(&bc::loss(&policy, &batch, &device).unwrap().tensor).unwrap();
    let difference: Vec<f32> = plain.iter().zip(&want_gradient).map(|(a, b)| a - b).collect();
    assert!(norm(&difference) > 1e-2 * norm(&want_gradient));

    // The same rows given as rows of a pool.
    let pooled = Regularizer { observations: Some(&batch.observations), ..regularizer };
    let pooled = policy.gradient(&loss(&policy, &batch, pooled, &device).unwrap().tensor).unwrap();
    let difference: Vec<f32> = pooled.iter().zip(&got_gradient).map(|(a, b)| a - b).collect();
    assert!(norm(&difference) < 2e-5 * norm(&want_gradient), "{}", norm(&difference));
}
