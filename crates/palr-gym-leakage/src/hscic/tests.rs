//! The estimator against the literal equation, in the plainest double-precision code there is.

use palr_gym_core::random::Generator;
use proptest::prelude::*;

use super::*;

type Rows = Vec<Vec<f64>>;

fn kernel(rows: &Rows) -> Rows {
    rows.iter()
        .map(|a| {
            rows.iter()
                .map(|b| (-a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum::<f64>()).exp())
                .collect()
        })
        .collect()
}

fn product(a: &Rows, b: &Rows) -> Rows {
    let n = b[0].len();
    a.iter()
        .map(|row| (0..n).map(|j| row.iter().zip(b).map(|(x, r)| x * r[j]).sum()).collect())
        .collect()
}

fn transpose(a: &Rows) -> Rows {
    (0..a[0].len()).map(|j| a.iter().map(|row| row[j]).collect()).collect()
}

fn elementwise(a: &Rows, b: &Rows) -> Rows {
    a.iter().zip(b).map(|(x, y)| x.iter().zip(y).map(|(p, q)| p * q).collect()).collect()
}

/// Gauss-Jordan with pivoting.
fn inverse(a: &Rows) -> Rows {
    let n = a.len();
    let mut work: Rows = a
        .iter()
        .enumerate()
        .map(|(i, row)| {
            let unit = (0..n).map(|j| if i == j { 1.0 } else { 0.0 });
            row.iter().copied().chain(unit).collect()
        })
        .collect();
    for column in 0..n {
        let pivot = (column..n)
            .max_by(|&i, &j| work[i][column].abs().total_cmp(&work[j][column].abs()))
            .unwrap();
        work.swap(column, pivot);
        let scale = work[column][column];
        work[column].iter_mut().for_each(|value| *value /= scale);
        let pivot_row = work[column].clone();
        for (_, row) in work.iter_mut().enumerate().filter(|(i, _)| *i != column) {
            let factor = row[column];
            row.iter_mut().zip(&pivot_row).for_each(|(value, pivot)| *value -= factor * pivot);
        }
    }
    work.into_iter().map(|row| row[n..].to_vec()).collect()
}

/// Equation (7), term by term, the trace taken at the end.
fn literal(x: &Rows, y: &Rows, z: &Rows, ridge: f64) -> f64 {
    let n = x.len();
    let (kx, ky, kz) = (kernel(x), kernel(y), kernel(z));
    let mut regularised = kz.clone();
    for (i, row) in regularised.iter_mut().enumerate() {
        row[i] += n as f64 * ridge;
    }
    let w = inverse(&regularised);
    let left = product(&transpose(&kz), &w);
    let right = product(&transpose(&w), &kz);
    let first = product(&product(&left, &elementwise(&kx, &ky)), &right);
    let inner = elementwise(&product(&kx, &right), &product(&ky, &right));
    let second = product(&left, &inner);
    let x_part = product(&product(&left, &kx), &right);
    let y_part = product(&product(&left, &ky), &right);
    let third = elementwise(&x_part, &y_part);
    (0..n).map(|i| first[i][i] - 2.0 * second[i][i] + third[i][i]).sum::<f64>() / n as f64
}

fn matrix(rows: &Rows) -> Mat<f64> {
    Mat::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j])
}

fn estimate(x: &Rows, y: &Rows, z: &Rows) -> Hscic {
    hscic(matrix(x).as_ref(), matrix(y).as_ref(), matrix(z).as_ref(), &HscicConfig::default())
        .unwrap()
}

/// Actions in (-1, 1), consecutive ones alike, and a representation that sees both.
fn samples(n: usize, d: usize, seed: u64) -> (Rows, Rows, Rows) {
    let mut generator = Generator::from_seed(seed);
    let mut noise = |scale: f64| scale * generator.standard_normal();
    let z: Rows = (0..n).map(|_| (0..d).map(|_| noise(1.0).tanh()).collect()).collect();
    let y: Rows =
        z.iter().map(|row| row.iter().map(|v| (0.9 * v + noise(0.3)).tanh()).collect()).collect();
    let x = y
        .iter()
        .zip(&z)
        .map(|(a, b)| a.iter().zip(b).map(|(p, q)| 0.4 * p + 0.2 * q + noise(0.1)).collect())
        .collect();
    (x, y, z)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn the_estimate_is_the_literal_equation(n in 2..40usize, d in 1..9usize, seed in 0..1000u64) {
        let (x, y, z) = samples(n, d, seed);
        let expected = literal(&x, &y, &z, 1e-5);
        let got = estimate(&x, &y, &z);
        prop_assert!((got.value - expected).abs() <= 1e-9 * expected.abs().max(1e-6), "{} {expected}", got.value);
        prop_assert!(got.per_point.iter().all(|term| *term > -1e-10));
    }

    #[test]
    fn it_is_symmetric_and_blind_to_the_order_of_samples(n in 3..60usize, seed in 0..1000u64) {
        let (x, y, z) = samples(n, 3, seed);
        let value = estimate(&x, &y, &z).value;
        prop_assert!((estimate(&y, &x, &z).value - value).abs() < 1e-11);
        let shuffled = |rows: &Rows| -> Rows { (0..n).map(|i| rows[(i * 7 + 3) % n].clone()).collect() };
        // 7 and n must have no common factor for this to be a permutation.
        prop_assume!(n % 7 != 0);
        let permuted = estimate(&shuffled(&x), &shuffled(&y), &shuffled(&z)).value;
        prop_assert!((permuted - value).abs() < 1e-11);
    }
}

#[test]
fn dependence_is_seen_and_its_absence_too() {
    let n = 500;
    // One dimension: in more, so few samples leave the regression a bias that hides the difference.
    let (x, y, z) = samples(n, 1, 1);
    let leaking = estimate(&x, &y, &z).value;
    // A representation that is a function of the current action only.
    let clean: Rows = z.iter().map(|row| row.iter().map(|v| 0.6 * v).collect()).collect();
    let blind = estimate(&clean, &y, &z).value;
    assert!(leaking > 10.0 * blind, "{leaking} against {blind}");
    let constant: Rows = vec![vec![0.25]; n];
    // Not zero: the ridge keeps the regression's weights from summing to one.
    let nothing = estimate(&constant, &y, &z).value;
    assert!(nothing.abs() < 1e-3 * leaking, "{nothing} against {leaking}");
}

#[test]
fn what_cannot_be_estimated_is_refused_with_the_reason() {
    let (x, y, z) = samples(10, 2, 0);
    let config = HscicConfig::default();
    let refusal = |x: &Rows, y: &Rows, config: &HscicConfig| {
        hscic(matrix(x).as_ref(), matrix(y).as_ref(), matrix(&z).as_ref(), config)
            .unwrap_err()
            .to_string()
    };
    assert_eq!(
        refusal(&x, &y[..9].to_vec(), &config),
        "past_action has 9 rows, representation has 10; expected one row a sample in each"
    );
    let mut nan = x.clone();
    nan[4][1] = f64::NAN;
    assert_eq!(
        refusal(&nan, &y, &config),
        "representation has NaN at row 4, column 1; expected finite numbers"
    );
    let mut constant = y.clone();
    constant.iter_mut().for_each(|row| row[1] = 0.5);
    refuse_constant("past_action", matrix(&y).as_ref()).unwrap();
    assert_eq!(
        refuse_constant("past_action", matrix(&constant).as_ref()).unwrap_err().to_string(),
        "column 1 of past_action is 0.5 in all 10 samples; expected values that vary"
    );
    let negative = HscicConfig { ridge: -1.0, ..config };
    assert_eq!(refusal(&x, &y, &negative), "ridge is -1; expected a positive, finite number");
    let one = Mat::from_fn(1, 1, |_, _| 0.0);
    let error = hscic(one.as_ref(), one.as_ref(), one.as_ref(), &config).unwrap_err();
    assert_eq!(error.to_string(), "1 samples; expected at least 2");
}

/// k equal samples are one direction: its eigenvalue of K is n, so tr(A) = n / (n + nλ).
#[test]
fn the_effective_dimension_is_that_of_the_analytic_cases() {
    let config = HscicConfig { ridge: 0.1, bandwidth_sq: 1.0 };
    let equal = Mat::from_fn(20, 2, |_, _| 0.3);
    let got = effective_dimension(equal.as_ref(), &config).unwrap();
    assert!((got - 1.0 / 1.1).abs() < 1e-10, "{got}");
    // Samples far apart: K = I, so each direction has 1 / (1 + nλ).
    let apart = Mat::from_fn(20, 1, |i, _| 100.0 * i as f64);
    let got = effective_dimension(apart.as_ref(), &config).unwrap();
    assert!((got - 20.0 / 3.0).abs() < 1e-10, "{got}");
}
