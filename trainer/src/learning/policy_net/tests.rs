use palr_gym_core::random::Generator;

use super::*;
use crate::learning::data::{Batch, TrainingSet};
use crate::learning::likelihood;
use crate::learning::network::{split, tensor, values};

const SHAPE: PolicyShape =
    PolicyShape { observation_size: 5, action_size: 2, join: Join::Nowhere, is_bottleneck: false };

/// The loss of `batch`: for its gradient, and its value.
fn loss(policy: &PolicyNet, batch: &Batch) -> (Tensor<1>, f64) {
    let batch = batch.tensors(&Device::flex());
    likelihood::of_batch(&policy.forward(batch.observations.clone()), &batch).unwrap()
}

/// A set of `n` rows with actions up to exactly ±1.
fn set(n: usize) -> TrainingSet {
    let mut generator = Generator::from_seed(21);
    let mut draw =
        |count| -> Vec<f32> { (0..count).map(|_| generator.standard_normal() as f32).collect() };
    let observations = draw(n * 5);
    let actions = draw(n * 2).into_iter().map(|x| x.clamp(-1.0, 1.0)).collect();
    TrainingSet::new(&observations, 5, actions, vec![0.0; n * 2], 2).unwrap()
}

/// The recipe, number by number in double precision: φ, mean and clamped log_std of one row.
fn literal_forward(parameters: &[f64], row: &[f64]) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
    let mut at = 0;
    let mut linear = |input: &[f64], outputs: usize, has_bias: bool| -> Vec<f64> {
        let weight = &parameters[at..at + input.len() * outputs];
        at += weight.len();
        let bias: Vec<f64> = match has_bias {
            true => parameters[at..at + outputs].to_vec(),
            false => vec![0.0; outputs],
        };
        at += if has_bias { outputs } else { 0 };
        (0..outputs)
            .map(|o| {
                let terms = input.iter().enumerate().map(|(i, x)| x * weight[i * outputs + o]);
                bias[o] + terms.sum::<f64>()
            })
            .collect()
    };
    let leaky = |x: &[f64]| x.iter().map(|&x| if x > 0.0 { x } else { 0.2 * x }).collect();
    let encoded: Vec<f64> = leaky(&linear(row, 128, false));
    let phi = linear(&encoded, 64, true);
    let active: Vec<f64> = leaky(&phi);
    let hidden: Vec<f64> = leaky(&linear(&active, 128, true));
    let mean = linear(&hidden, 2, true);
    let log_std = linear(&hidden, 2, true).iter().map(|x| x.clamp(-20.0, 2.0)).collect();
    (phi, mean, log_std)
}

/// Mean of -log p(tanh u), with tanh's slope as 1 - tanh² of the clamped action itself.
fn literal_nll(parameters: &[f64], rows: &[f32], actions: &[f32]) -> f64 {
    let n = rows.len() / 5;
    let total: f64 = (0..n)
        .map(|i| {
            let row: Vec<f64> = rows[i * 5..(i + 1) * 5].iter().map(|&x| f64::from(x)).collect();
            let (_, mean, log_std) = literal_forward(parameters, &row);
            (0..2)
                .map(|c| {
                    let action = f64::from(actions[i * 2 + c].clamp(-0.999_999, 0.999_999));
                    let (u, std) = (action.atanh(), log_std[c].exp());
                    let density = (-0.5 * ((u - mean[c]) / std).powi(2)).exp()
                        / (std * (2.0 * std::f64::consts::PI).sqrt());
                    -(density / (1.0 - action * action)).ln()
                })
                .sum::<f64>()
        })
        .sum();
    total / n as f64
}

fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&x| f64::from(x)).collect()
}

#[test]
fn likelihood_and_gradient_are_those_of_a_literal_transcription() {
    let set = set(12);
    let batch = set.batch(&(0..12).collect::<Vec<_>>());
    let (_, actions) = set.hscic_actions(&(0..12).collect::<Vec<_>>(), false);
    let parameters = SHAPE.network(1).parameters;
    let device = Device::flex().autodiff();
    let policy = PolicyNet::new(SHAPE, &parameters, &device).unwrap();
    let (loss, nll) = loss(&policy, &batch);
    let mut exact = wide(&parameters);
    let want = literal_nll(&exact, &batch.observations, &actions);
    assert!((nll - want).abs() < 1e-5 * want.abs(), "{nll} {want}");

    let gradient = policy.gradient(&loss).unwrap();
    assert_eq!(gradient.len(), SHAPE.parameter_count());
    for index in (0..gradient.len()).step_by(997).chain([gradient.len() - 1]) {
        let mut at = |shift: f64| {
            let value = exact[index];
            exact[index] = value + shift;
            let result = literal_nll(&exact, &batch.observations, &actions);
            exact[index] = value;
            result
        };
        let want = (at(1e-5) - at(-1e-5)) / 2e-5;
        let error = (f64::from(gradient[index]) - want).abs();
        assert!(error < 1e-4 * want.abs() + 1e-5, "{index}: {} {want}", gradient[index]);
    }
}

#[test]
fn log_std_is_clamped_and_then_has_no_gradient() {
    let set = set(4);
    let batch = set.batch(&[0, 1, 2, 3]);
    let mut parameters = SHAPE.network(2).parameters;
    let count = parameters.len();
    parameters[count - 2..].copy_from_slice(&[50.0, -50.0]);
    let device = Device::flex().autodiff();
    let policy = PolicyNet::new(SHAPE, &parameters, &device).unwrap();
    let output = policy.forward(tensor(batch.observations.clone(), 5, &device));
    assert_eq!(values(output.log_std.inner()).unwrap(), [2.0, -20.0].repeat(4));
    let parameters = {
        let (mut parameters, last) = (parameters, count - 1);
        parameters[last] = 50.0;
        parameters
    };
    let policy = PolicyNet::new(SHAPE, &parameters, &device).unwrap();
    let gradient = policy.gradient(&loss(&policy, &batch).0).unwrap();
    assert_eq!(gradient[count - 2..], [0.0, 0.0]);
}

#[test]
fn initial_parameters_follow_from_the_seed_and_fill_torchs_bounds() {
    let parameters = SHAPE.network(3).parameters;
    assert_eq!(parameters, SHAPE.network(3).parameters);
    assert_ne!(parameters, SHAPE.network(4).parameters);
    for layer in split(&SHAPE.layers(), &parameters).unwrap() {
        let bound = 1.0 / (layer.shape.inputs as f32).sqrt();
        let largest = layer.weight.iter().fold(0.0_f32, |max, x| max.max(x.abs()));
        assert!((0.97 * bound..=bound).contains(&largest), "{}: {largest}", layer.shape.name);
        assert!(layer.bias.into_iter().flatten().all(|x| x.abs() <= bound));
    }
    let error = split(&SHAPE.layers(), &parameters[1..]).unwrap_err().to_string();
    assert_eq!(error, "the list of parameters has size 17731; expected 17732");
}
