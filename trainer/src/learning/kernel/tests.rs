use palr_gym_core::random::Generator;

use super::*;
use crate::learning::weights::KernelConfig;

/// Standard normals times `scale`.
fn normals(seed: u64, count: usize, scale: f64) -> Vec<f32> {
    let mut generator = Generator::from_seed(seed);
    (0..count).map(|_| (generator.standard_normal() * scale) as f32).collect()
}

/// M of random actions, and its entries.
fn weights(n: usize) -> (WeightMatrix, impl Fn(usize, usize) -> f64) {
    let config = KernelConfig { ridge: 1e-5, bandwidth_sq: 1.0 };
    let (past, given) = (normals(1, n * 3, 0.5), normals(2, n * 3, 0.5));
    let matrix = WeightMatrix::new(&past, &given, 3, config).unwrap();
    let (entries, diagonal) = (matrix.clone(), matrix.diagonal());
    let entry = move |i: usize, j: usize| match i == j {
        true => f64::from(diagonal[i]),
        false => f64::from(entries.below(i.max(j))[i.min(j)]),
    };
    (matrix, entry)
}

/// `⟨K, M⟩ / n`, entry by entry in double precision.
fn plain(phi: &[f64], d: usize, entry: &impl Fn(usize, usize) -> f64, bandwidth_sq: f64) -> f64 {
    let n = phi.len() / d;
    let mut sum = 0.0;
    for i in 0..n {
        for j in 0..n {
            let distance_sq: f64 = (0..d).map(|c| (phi[i * d + c] - phi[j * d + c]).powi(2)).sum();
            sum += (-distance_sq / bandwidth_sq).exp() * entry(i, j);
        }
    }
    sum / n as f64
}

#[test]
fn exp_is_exact_to_single_precision_and_never_negative() {
    for i in 0..200_000 {
        let x = -(i as f32) * 4.3e-4;
        let want = f64::from(x).exp();
        let tolerance = (3e-7 - 1e-7 * f64::from(x)) * want;
        assert!((f64::from(exp(x)) - want).abs() <= tolerance, "{x}");
    }
    assert_eq!(exp(0.0), 1.0);
    assert!((0.0..1e-37).contains(&exp(-1e30)) && (0.0..1e-37).contains(&exp(f32::NEG_INFINITY)));
}

/// Sizes below, at, across and above the block's, and several widths and bandwidths.
#[test]
fn value_and_gradient_are_those_of_the_plain_sum_and_its_finite_differences() {
    for (n, d, bandwidth_sq) in [(2, 1, 1.0), (37, 5, 1.0), (128, 64, 1.0), (300, 64, 2.5)] {
        let (matrix, entry) = weights(n);
        let phi = normals(3, n * d, 1.0 / (d as f64).sqrt());
        let got = hscic_gradient(&phi, d, &matrix, bandwidth_sq);
        let mut exact: Vec<f64> = phi.iter().map(|&x| f64::from(x)).collect();
        let want = plain(&exact, d, &entry, bandwidth_sq);
        assert!((got.value - want).abs() < 1e-5 * want.abs() + 1e-8, "{n}: {} {want}", got.value);

        let largest = got.gradient.iter().fold(0.0_f32, |max, x| max.max(x.abs()));
        for index in [0, n * d / 3, n * d - 1] {
            let mut at = |shift: f64| {
                let value = exact[index];
                exact[index] = value + shift;
                let result = plain(&exact, d, &entry, bandwidth_sq);
                exact[index] = value;
                result
            };
            let want = (at(1e-4) - at(-1e-4)) / 2e-4;
            let error = (f64::from(got.gradient[index]) - want).abs();
            assert!(error < 3e-4 * f64::from(largest), "{n} {index}: {error} of {largest}");
        }
    }
}

#[test]
fn far_apart_representations_have_no_gradient_and_no_nan() {
    let (matrix, entry) = weights(40);
    let phi: Vec<f32> = (0..40 * 2).map(|i| i as f32 * 1e3).collect();
    let got = hscic_gradient(&phi, 2, &matrix, 1.0);
    let trace: f64 = (0..40).map(|i| entry(i, i)).sum();
    assert!((got.value - trace / 40.0).abs() < 1e-9);
    assert!(got.gradient.iter().all(|x| x.abs() < 1e-20));
}
