use faer::Side;
use faer::linalg::solvers::{DenseSolveCore, Llt};
use palr_gym_core::random::Generator;
use palr_gym_leakage::{HscicConfig, hscic};

use super::*;
use crate::learning::kernel::hscic_gradient;

const CONFIG: KernelConfig = KernelConfig { ridge: 1e-5, bandwidth_sq: 1.0 };

/// Past and given actions that depend on each other, as an expert's do: `[n, d]` each.
fn actions(n: usize, d: usize) -> (Vec<f32>, Vec<f32>) {
    let mut generator = Generator::from_seed(11);
    let given: Vec<f64> = (0..n * d).map(|_| generator.standard_normal().tanh()).collect();
    let past = given.iter().map(|z| (0.9 * z + 0.3 * generator.standard_normal()).tanh() as f32);
    (past.collect(), given.iter().map(|&z| z as f32).collect())
}

fn square(matrix: &WeightMatrix) -> Mat<f64> {
    let diagonal = matrix.diagonal();
    Mat::from_fn(matrix.n(), matrix.n(), |i, j| match i == j {
        true => f64::from(diagonal[i]),
        false => f64::from(matrix.below(i.max(j))[i.min(j)]),
    })
}

/// The doc's formula, letter by letter in double precision, not symmetrised.
fn literal(past: &[f32], given: &[f32], d: usize) -> Mat<f64> {
    let (ky, kz) = (kernel_f64(past, d, 1.0), kernel_f64(given, d, 1.0));
    let n = ky.nrows();
    let shifted =
        Mat::from_fn(n, n, |i, j| kz[(i, j)] + if i == j { n as f64 * CONFIG.ridge } else { 0.0 });
    let a = Llt::new(shifted.as_ref(), Side::Lower).unwrap().inverse() * &kz;
    let aa = &a * a.transpose();
    let kya = &ky * &a;
    let aka = a.transpose() * &kya;
    let second = Mat::from_fn(n, n, |i, j| a[(i, j)] * kya[(i, j)]) * a.transpose();
    let third = Mat::from_fn(n, n, |i, j| a[(i, j)] * aka[(j, j)]) * a.transpose();
    Mat::from_fn(n, n, |i, j| ky[(i, j)] * aa[(i, j)] - 2.0 * second[(i, j)] + third[(i, j)])
}

fn norm(matrix: &Mat<f64>) -> f64 {
    matrix.col_iter().flat_map(|column| column.iter().map(|x| x * x)).sum::<f64>().sqrt()
}

#[test]
fn entries_are_those_of_the_literal_formula_and_survive_packing() {
    // With two samples M all but vanishes: only rounding is left.
    for (n, d) in [(2, 1), (50, 3), (150, 8)] {
        let (past, given) = actions(n, d);
        let matrix = WeightMatrix::new(&past, &given, d, CONFIG).unwrap();
        let want = literal(&past, &given, d);
        let want = (&want + want.transpose()) * faer::Scale(0.5);
        let scale = norm(&want) + 1e-2;
        let error = norm(&(square(&matrix) - &want)) / scale;
        assert!(error < 2e-4, "{n} {d}: {error}");
        let error = norm(&(square(&matrix.pack().unpack()) - &want)) / scale;
        assert!(error < 5e-4, "{n} {d}, packed: {error}");
    }
}

#[test]
fn it_has_no_negative_eigenvalue_beyond_rounding() {
    let (past, given) = actions(120, 3);
    let matrix = square(&WeightMatrix::new(&past, &given, 3, CONFIG).unwrap());
    let eigenvalues = matrix.self_adjoint_eigenvalues(Side::Lower).unwrap();
    let (lowest, highest) = (eigenvalues[0], eigenvalues[119]);
    assert!(lowest > -1e-4 * highest, "{lowest} {highest}");
}

/// Through an estimator that shares no code: the point-by-point one of the leakage crate.
#[test]
fn it_gives_the_estimate_of_the_leakage_crate() {
    let (n, d) = (100, 3);
    let (past, given) = actions(n, d);
    let mut generator = Generator::from_seed(4);
    let phi: Vec<f32> =
        (0..n * d).map(|i| past[i] + 0.3 * generator.standard_normal() as f32).collect();
    let matrix = WeightMatrix::new(&past, &given, d, CONFIG).unwrap();
    let got = hscic_gradient(&phi, d, &matrix, 1.0).value;
    let wide = |x: &[f32]| Mat::from_fn(n, d, |i, c| f64::from(x[i * d + c]));
    let config = HscicConfig::default();
    let want =
        hscic(wide(&phi).as_ref(), wide(&past).as_ref(), wide(&given).as_ref(), &config).unwrap();
    assert!((got - want.value).abs() < 1e-4 * want.value, "{got} {}", want.value);
}

/// Equal actions make K_z singular, and this ridge is lost in single precision.
#[test]
fn double_precision_steps_in_where_single_has_no_factor() {
    let given = vec![0.25_f32; 60];
    let (past, _) = actions(60, 1);
    let config = KernelConfig { ridge: 1e-10, ..CONFIG };
    let single = kernel_f32(&given, 1, 1.0);
    assert!(lower_triangle(&single, single.clone(), (60.0 * config.ridge) as f32).is_none());
    let matrix = WeightMatrix::new(&past, &given, 1, config).unwrap();
    assert!(matrix.diagonal().iter().all(|entry| entry.is_finite()));
    let config = KernelConfig { ridge: 1e-30, ..CONFIG };
    let error = WeightMatrix::new(&past, &given, 1, config).unwrap_err();
    assert!(matches!(error, TrainError::Singular { .. }), "{error}");
}
