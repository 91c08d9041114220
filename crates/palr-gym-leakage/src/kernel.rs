//! The Gaussian kernel of the PALR paper.

use faer::{Mat, MatRef};

/// `k(x, y) = exp(-‖x - y‖² / bandwidth_sq)`, without a factor 2, between all rows.
///
/// # Shapes
/// `[n, d]` -> `[n, n]`, symmetric, ones on the diagonal.
#[must_use]
pub fn gaussian(samples: MatRef<'_, f64>, bandwidth_sq: f64) -> Mat<f64> {
    let (n, d) = samples.shape();
    // Rows side by side in memory, and each pair computed once.
    let rows: Vec<f64> = (0..n).flat_map(|i| (0..d).map(move |c| samples[(i, c)])).collect();
    let mut kernel = Mat::<f64>::identity(n, n);
    for j in 0..n {
        let right = &rows[j * d..(j + 1) * d];
        for i in j + 1..n {
            let left = &rows[i * d..(i + 1) * d];
            let distance_sq: f64 = left.iter().zip(right).map(|(a, b)| (a - b).powi(2)).sum();
            let value = (-distance_sq / bandwidth_sq).exp();
            kernel[(i, j)] = value;
            kernel[(j, i)] = value;
        }
    }
    kernel
}
