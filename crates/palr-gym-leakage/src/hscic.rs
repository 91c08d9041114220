//! The Hilbert-Schmidt conditional independence criterion.

use faer::linalg::solvers::{DenseSolveCore, Llt};
use faer::{Mat, MatRef, Side};

use crate::error::LeakageError;
use crate::kernel::gaussian;

/// Settings of the estimator. The defaults are the paper's (section 5).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HscicConfig {
    /// λ of the ridge regression; enters the kernel matrix as n·λ.
    pub ridge: f64,
    /// σ² of all three kernels, `exp(-d² / σ²)`.
    pub bandwidth_sq: f64,
}

impl Default for HscicConfig {
    fn default() -> Self {
        Self { ridge: 1e-5, bandwidth_sq: 1.0 }
    }
}

/// An estimate.
#[derive(Debug, Clone, PartialEq)]
pub struct Hscic {
    /// The criterion: the mean of `per_point`.
    pub value: f64,
    /// `[n]`: the criterion at each sample's given action, each >= 0 up to rounding.
    pub per_point: Vec<f64>,
}

/// Kernel estimate of how much `representation` depends on `past_action` given `given_action`.
///
/// # Shapes
/// `[n, d_repr]`, `[n, d_act]`, `[n, d_act]`; n >= 2. Memory O(n²), time O(n³).
///
/// # Source
/// Equation (7) of the PALR paper. With `A = (K_z + nλI)⁻¹ K_z`, whose column `w` holds the weights
/// that regression gives the samples at one point, the term of that point is
/// `wᵀ(K_x∘K_y)w - 2 wᵀ((K_x w)∘(K_y w)) + (wᵀK_x w)(wᵀK_y w)`, a squared distance of embeddings;
/// the equation is their mean. Only the order of the sums differs.
///
/// # Errors
/// Any [`LeakageError`] but [`LeakageError::Blocks`].
pub fn hscic(
    representation: MatRef<'_, f64>,
    past_action: MatRef<'_, f64>,
    given_action: MatRef<'_, f64>,
    config: &HscicConfig,
) -> Result<Hscic, LeakageError> {
    check(representation, past_action, given_action, config)?;
    let bandwidth_sq = config.bandwidth_sq;
    let weights = regression_weights(given_action, config)?;
    let kernel_x = gaussian(representation, bandwidth_sq);
    let kernel_y = gaussian(past_action, bandwidth_sq);
    let n = weights.nrows();

    let product = Mat::from_fn(n, n, |i, j| kernel_x[(i, j)] * kernel_y[(i, j)]);
    let joint = &product * &weights;
    let embedded_x = &kernel_x * &weights;
    let embedded_y = &kernel_y * &weights;
    let per_point: Vec<f64> = (0..n)
        .map(|point| {
            let (mut first, mut second, mut x, mut y) = (0.0, 0.0, 0.0, 0.0);
            for i in 0..n {
                let weight = weights[(i, point)];
                let (at_x, at_y) = (embedded_x[(i, point)], embedded_y[(i, point)]);
                first += weight * joint[(i, point)];
                second += weight * at_x * at_y;
                x += weight * at_x;
                y += weight * at_y;
            }
            first - 2.0 * second + x * y
        })
        .collect();
    Ok(Hscic { value: per_point.iter().sum::<f64>() / n as f64, per_point })
}

/// tr(A), the number of directions in which regression on `given_action` can still tell samples
/// apart: between 0 and n. Near n, the regression interpolates, and leakage is hard to see.
///
/// # Shapes
/// `[n, d_act]`; time O(n³).
///
/// # Errors
/// [`LeakageError::Singular`].
pub fn effective_dimension(
    given_action: MatRef<'_, f64>,
    config: &HscicConfig,
) -> Result<f64, LeakageError> {
    let weights = regression_weights(given_action, config)?;
    Ok((0..weights.nrows()).map(|i| weights[(i, i)]).sum())
}

/// `A = (K_z + nλI)⁻¹ K_z`, computed as `I - nλ (K_z + nλI)⁻¹`, which loses fewer digits.
fn regression_weights(
    given_action: MatRef<'_, f64>,
    config: &HscicConfig,
) -> Result<Mat<f64>, LeakageError> {
    let mut regularised = gaussian(given_action, config.bandwidth_sq);
    let n = regularised.nrows();
    let shift = n as f64 * config.ridge;
    for i in 0..n {
        regularised[(i, i)] += shift;
    }
    let singular = |_| LeakageError::Singular { name: "given_action", ridge: config.ridge };
    let factor = Llt::new(regularised.as_ref(), Side::Lower).map_err(singular)?;
    let inverse = factor.inverse();
    Ok(Mat::from_fn(n, n, |i, j| f64::from(u8::from(i == j)) - shift * inverse[(i, j)]))
}

/// Refuses an array with a column that has one value only. The estimate is defined there, and near
/// zero; but in recorded data it means an array that was never filled, or the wrong one.
///
/// # Errors
/// [`LeakageError::Constant`].
pub fn refuse_constant(name: &'static str, array: MatRef<'_, f64>) -> Result<(), LeakageError> {
    let samples = array.nrows();
    for column in 0..array.ncols() {
        if samples >= 2 && (1..samples).all(|row| array[(row, column)] == array[(0, column)]) {
            let value = array[(0, column)];
            return Err(LeakageError::Constant { name, column, value, samples });
        }
    }
    Ok(())
}

fn check(
    representation: MatRef<'_, f64>,
    past_action: MatRef<'_, f64>,
    given_action: MatRef<'_, f64>,
    config: &HscicConfig,
) -> Result<(), LeakageError> {
    for (name, got) in [("ridge", config.ridge), ("bandwidth_sq", config.bandwidth_sq)] {
        if !(got.is_finite() && got > 0.0) {
            return Err(LeakageError::NotPositive { name, got });
        }
    }
    let arrays = [
        ("representation", representation),
        ("past_action", past_action),
        ("given_action", given_action),
    ];
    let (first, want) = ("representation", representation.nrows());
    for (name, array) in arrays {
        let got = array.nrows();
        if got != want {
            return Err(LeakageError::Length { name, got, first, want });
        }
        if array.ncols() == 0 {
            return Err(LeakageError::NoColumns { name });
        }
        for row in 0..array.nrows() {
            for column in 0..array.ncols() {
                let value = array[(row, column)];
                if !value.is_finite() {
                    return Err(LeakageError::NotFinite { name, row, column, value });
                }
            }
        }
    }
    if want < 2 {
        return Err(LeakageError::TooFew { got: want });
    }
    Ok(())
}

#[cfg(test)]
mod tests;
