//! The matrix M of a batch: HSCIC(x, y | z) = ⟨K_x, M⟩ / n.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt;
use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::traits::RealField;
use faer::{Accum, Mat, Par};
use half::f16;
use half::slice::HalfFloatSliceExt;
use pulp::{Arch, Simd};

use crate::learning::error::TrainError;
use crate::learning::kernel::exp;

/// The kernels' settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KernelConfig {
    /// λ of the ridge regression; enters the kernel matrix as n·λ.
    pub ridge: f64,
    /// σ² of all kernels, `exp(-d² / σ²)`.
    pub bandwidth_sq: f64,
}

/// M, symmetric and positive semi-definite up to rounding.
#[derive(Debug, Clone, PartialEq)]
pub struct WeightMatrix {
    n: usize,
    /// The lower triangle, row after row: row i has i + 1 entries.
    lower: Vec<f32>,
}

impl WeightMatrix {
    /// M of past actions y and given actions z, `[n, action_size]` each.
    ///
    /// # Source
    /// Equation (7) of the PALR paper, rearranged. With A = (K_z + nλI)⁻¹ K_z = I - nλ (K_z + nλI)⁻¹,
    /// symmetric, M = K_y ∘ (A Aᵀ) - 2 (A ∘ (K_y A)) Aᵀ + A diag(d) Aᵀ, d_i = (Aᵀ K_y A)_ii, and
    /// its symmetric part is taken. In single precision, on one thread; in double precision if the
    /// Cholesky factor does not exist in single.
    ///
    /// # Errors
    /// [`TrainError::Singular`].
    pub fn new(
        past_actions: &[f32],
        given_actions: &[f32],
        action_size: usize,
        config: KernelConfig,
    ) -> Result<Self, TrainError> {
        let n = given_actions.len() / action_size;
        let shift = n as f64 * config.ridge;
        let past = kernel_f32(past_actions, action_size, config.bandwidth_sq);
        let given = kernel_f32(given_actions, action_size, config.bandwidth_sq);
        if let Some(lower) = lower_triangle(&past, given, shift as f32) {
            return Ok(Self { n, lower });
        }
        let past = kernel_f64(past_actions, action_size, config.bandwidth_sq);
        let given = kernel_f64(given_actions, action_size, config.bandwidth_sq);
        let lower = lower_triangle(&past, given, shift)
            .ok_or(TrainError::Singular { ridge: config.ridge })?;
        Ok(Self { n, lower: lower.into_iter().map(|entry| entry as f32).collect() })
    }

    /// Number of samples.
    #[must_use]
    pub fn n(&self) -> usize {
        self.n
    }

    /// Row i left of the diagonal, `[i]`.
    #[must_use]
    pub fn below(&self, i: usize) -> &[f32] {
        &self.lower[i * (i + 1) / 2..][..i]
    }

    /// `[n]`.
    #[must_use]
    pub fn diagonal(&self) -> Vec<f32> {
        (0..self.n).map(|i| self.lower[i * (i + 1) / 2 + i]).collect()
    }

    /// Half the size, for keeping many.
    #[must_use]
    pub fn pack(&self) -> PackedWeights {
        let largest = self.lower.iter().fold(f32::MIN_POSITIVE, |max, entry| max.max(entry.abs()));
        // A power of two, so that scaling itself rounds nothing, and as large as it may be, so that
        // small entries keep their digits.
        let scale = 2.0_f32.powi((14 - largest.log2().ceil() as i32).clamp(-100, 100));
        let scaled: Vec<f32> = self.lower.iter().map(|entry| entry * scale).collect();
        let mut lower = vec![f16::ZERO; scaled.len()];
        lower.convert_from_f32_slice(&scaled);
        PackedWeights { n: self.n, scale, lower }
    }
}

/// M in half precision: the gradient's error of 2e-4 is that of single-precision arithmetic.
#[derive(Debug, Clone)]
pub struct PackedWeights {
    n: usize,
    scale: f32,
    lower: Vec<f16>,
}

impl PackedWeights {
    /// Back to single precision.
    #[must_use]
    pub fn unpack(&self) -> WeightMatrix {
        let mut lower = vec![0.0; self.lower.len()];
        self.lower.convert_to_f32_slice(&mut lower);
        let scale = 1.0 / self.scale;
        lower.iter_mut().for_each(|entry| *entry *= scale);
        WeightMatrix { n: self.n, lower }
    }
}

/// f32 and f64.
trait Real:
    RealField
    + Copy
    + From<f32>
    + std::ops::Add<Output = Self>
    + std::ops::Mul<Output = Self>
    + std::ops::Neg<Output = Self>
    + std::ops::AddAssign
{
    fn is_finite(self) -> bool;
}

impl Real for f32 {
    fn is_finite(self) -> bool {
        f32::is_finite(self)
    }
}

impl Real for f64 {
    fn is_finite(self) -> bool {
        f64::is_finite(self)
    }
}

/// The lower triangle of M, row after row; `None` if K_z + `shift` I has no Cholesky factor.
fn lower_triangle<T: Real>(past: &Mat<T>, given: Mat<T>, shift: T) -> Option<Vec<T>> {
    let n = past.nrows();
    let regression = regression_weights(given, shift)?;
    let one = T::from(1.0_f32);
    let half = T::from(0.5_f32);
    let mut embedded = Mat::<T>::zeros(n, n);
    matmul(embedded.as_mut(), Accum::Replace, past, &regression, one, Par::Seq);
    let mut weights = Mat::<T>::zeros(n, n);
    let add_product = |out: &mut Mat<T>, accumulate, left: &Mat<T>, right: &Mat<T>, factor| {
        triangular::matmul(
            out.as_mut(),
            BlockStructure::TriangularLower,
            accumulate,
            left.as_ref(),
            BlockStructure::Rectangular,
            right.transpose(),
            BlockStructure::Rectangular,
            factor,
            Par::Seq,
        );
    };
    add_product(&mut weights, Accum::Replace, &regression, &regression, one);
    for j in 0..n {
        let regression = regression.col_as_slice(j);
        let embedded = embedded.col_as_slice_mut(j);
        let mut diagonal = T::from(0.0_f32);
        for (entry, &weight) in embedded.iter_mut().zip(regression) {
            *entry *= weight;
            diagonal += *entry;
        }
        for (entry, &weight) in embedded.iter_mut().zip(regression) {
            *entry = -(*entry + *entry) + diagonal * weight;
        }
        let entries = weights.col_as_slice_mut(j).iter_mut().zip(past.col_as_slice(j));
        for (entry, &kernel) in entries.skip(j) {
            *entry *= kernel;
        }
    }
    add_product(&mut weights, Accum::Add, &embedded, &regression, half);
    add_product(&mut weights, Accum::Add, &regression, &embedded, half);
    let mut lower = Vec::with_capacity(n * (n + 1) / 2);
    for i in 0..n {
        lower.extend((0..=i).map(|j| weights[(i, j)]));
    }
    lower.iter().all(|entry| entry.is_finite()).then_some(lower)
}

/// A = I - shift (K_z + shift I)⁻¹, both triangles.
fn regression_weights<T: Real>(mut given: Mat<T>, shift: T) -> Option<Mat<T>> {
    let n = given.nrows();
    for i in 0..n {
        given[(i, i)] += shift;
    }
    let scratch = llt::factor::cholesky_in_place_scratch::<T>(n, Par::Seq, Default::default());
    let scratch = scratch.or(llt::inverse::inverse_scratch::<T>(n, Par::Seq));
    let mut memory = MemBuffer::new(scratch);
    let stack = MemStack::new(&mut memory);
    llt::factor::cholesky_in_place(
        given.as_mut(),
        Default::default(),
        Par::Seq,
        stack,
        Default::default(),
    )
    .ok()?;
    let mut weights = Mat::<T>::zeros(n, n);
    llt::inverse::inverse(weights.as_mut(), given.as_ref(), Par::Seq, stack);
    for j in 0..n {
        for i in j..n {
            let entry = -(shift * weights[(i, j)]);
            weights[(i, j)] = entry;
            weights[(j, i)] = entry;
        }
        weights[(j, j)] += T::from(1.0_f32);
    }
    Some(weights)
}

/// Kernel matrix of `samples`, `[n, d]`.
fn kernel_f32(samples: &[f32], d: usize, bandwidth_sq: f64) -> Mat<f32> {
    let n = samples.len() / d;
    let scale = -1.0 / bandwidth_sq as f32;
    // One array for each coordinate, so that a column of the matrix is a pass over arrays.
    let coordinates: Vec<Vec<f32>> =
        (0..d).map(|c| samples.iter().skip(c).step_by(d).copied().collect()).collect();
    let mut kernel = Mat::<f32>::zeros(n, n);
    for j in 0..n {
        fill_column(&coordinates, j, scale, kernel.col_as_slice_mut(j));
    }
    kernel
}

/// Column `j` of a kernel matrix, which is 0 before.
#[pulp::with_simd(fill_column = Arch::new())]
#[inline(always)]
fn fill_column_with_simd<'a, S: Simd>(
    _simd: S,
    coordinates: &'a [Vec<f32>],
    j: usize,
    scale: f32,
    column: &'a mut [f32],
) {
    for coordinate in coordinates {
        let own = coordinate[j];
        for (distance_sq, other) in column.iter_mut().zip(coordinate) {
            let difference = own - other;
            *distance_sq += difference * difference;
        }
    }
    for entry in column {
        *entry = exp(*entry * scale);
    }
}

fn kernel_f64(samples: &[f32], d: usize, bandwidth_sq: f64) -> Mat<f64> {
    let row = |i: usize| samples[i * d..(i + 1) * d].iter().map(|&x| f64::from(x));
    let n = samples.len() / d;
    Mat::from_fn(n, n, |i, j| {
        let distance_sq: f64 = row(i).zip(row(j)).map(|(a, b)| (a - b).powi(2)).sum();
        (-distance_sq / bandwidth_sq).exp()
    })
}

#[cfg(test)]
mod tests;
