//! HSCIC of a representation and its gradient, given the weight matrix M of a batch.
//!
//! HSCIC is linear in the representation's kernel matrix, `⟨K, M⟩ / n`, and M depends on the
//! expert's actions only ([`crate::learning::weights`]). What is left is one pass over the lower
//! triangle of K, block row by block row, without ever holding all of it.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use pulp::{Arch, Simd};

use crate::learning::weights::WeightMatrix;

/// Rows of K at a time: 128 rows of 1024 numbers are 512 KiB, which caches hold.
const BLOCK: usize = 128;

/// HSCIC and how the representation changes it.
#[derive(Debug, Clone, PartialEq)]
pub struct HscicGradient {
    /// `⟨K, M⟩ / n`, accumulated in double precision.
    pub value: f64,
    /// `[n, d]`: the derivative of `value` by the representation.
    pub gradient: Vec<f32>,
}

/// HSCIC of `representation`, `[n, d]`, and its gradient.
///
/// # Source
/// With G = M ∘ K and k(x, y) = exp(-‖x - y‖² / σ²), the derivative is
/// `-(4 / (n σ²)) (diag(G 1) φ - G φ)`.
///
/// # Panics
/// If `representation` has not `weights.n()` rows of d numbers.
#[must_use]
pub fn hscic_gradient(
    representation: &[f32],
    d: usize,
    weights: &WeightMatrix,
    bandwidth_sq: f64,
) -> HscicGradient {
    let n = weights.n();
    assert_eq!(representation.len(), n * d, "expected {n} rows of {d}");
    let norms: Vec<f32> =
        representation.chunks_exact(d).map(|row| row.iter().map(|x| x * x).sum()).collect();
    // G φ and G 1, both without the diagonal, which cancels in their difference.
    let mut products = vec![0.0_f32; n * d];
    let mut sums = vec![0.0_f32; n];
    let mut below = 0.0;
    let exponent = -1.0 / bandwidth_sq as f32;
    let mut buffer = vec![0.0_f32; BLOCK.min(n) * n];
    for start in (0..n).step_by(BLOCK) {
        let end = (start + BLOCK).min(n);
        let rows = end - start;
        let block = &mut buffer[..rows * end];
        let left = MatRef::from_row_major_slice(&representation[start * d..end * d], rows, d);
        let right = MatRef::from_row_major_slice(&representation[..end * d], end, d);
        let out = MatMut::from_row_major_slice_mut(block, rows, end);
        matmul(out, Accum::Replace, left, right.transpose(), 1.0, Par::Seq);
        for (i, row) in (start..end).zip(block.chunks_exact_mut(end)) {
            let (row, after) = row.split_at_mut(i);
            after.fill(0.0);
            let (before, at) = sums.split_at_mut(i);
            let sum = weigh_row(row, &norms[..i], norms[i], weights.below(i), exponent, before);
            at[0] += sum as f32;
            below += sum;
        }
        let block = MatRef::from_row_major_slice(&*block, rows, end);
        let out = MatMut::from_row_major_slice_mut(&mut products[start * d..end * d], rows, d);
        matmul(out, Accum::Add, block, right, 1.0, Par::Seq);
        let out = MatMut::from_row_major_slice_mut(&mut products[..end * d], end, d);
        matmul(out, Accum::Add, block.transpose(), left, 1.0, Par::Seq);
    }
    let scale = (4.0 / (n as f64 * bandwidth_sq)) as f32;
    let gradient = products
        .iter()
        .zip(representation)
        .enumerate()
        .map(|(i, (product, x))| scale * (product - sums[i / d] * x))
        .collect();
    // The kernel is 1 on the diagonal.
    let diagonal: f64 = weights.diagonal().into_iter().map(f64::from).sum();
    HscicGradient { value: (diagonal + 2.0 * below) / n as f64, gradient }
}

/// Turns scalar products of one sample with those before it into G's entries, adds them to the
/// sums of those, and returns their own sum.
#[pulp::with_simd(weigh_row = Arch::new())]
#[inline(always)]
fn weigh_row_with_simd<'a, S: Simd>(
    _simd: S,
    row: &'a mut [f32],
    norms: &'a [f32],
    norm: f32,
    weights: &'a [f32],
    scale: f32,
    sums: &'a mut [f32],
) -> f64 {
    const LANES: usize = 8;
    let entries = row.iter_mut().zip(norms).zip(weights).zip(sums);
    for (((entry, &other), &weight), sum) in entries {
        let distance_sq = (norm + other - 2.0 * *entry).max(0.0);
        *entry = exp(distance_sq * scale) * weight;
        *sum += *entry;
    }
    let mut lanes = [0.0_f64; LANES];
    let chunks = row.chunks_exact(LANES);
    let rest: f64 = chunks.remainder().iter().map(|&entry| f64::from(entry)).sum();
    for chunk in chunks {
        for (lane, &entry) in lanes.iter_mut().zip(chunk) {
            *lane += f64::from(entry);
        }
    }
    lanes.iter().sum::<f64>() + rest
}

/// exp for x <= 0, to (3 + |x|) · 1e-7 of the value; below 1e-37 for x < -87. Branch-free, so that
/// compilers vectorise it.
///
/// # Source
/// exp(x) = 2^i 2^f with |f| <= ½; 2^f by its Taylor polynomial of degree 6.
#[inline(always)]
pub(crate) fn exp(x: f32) -> f32 {
    /// 1.5 · 2²³: a sum with it has no room for a fraction, and its low bits are the integer.
    const ROUND: f32 = 12_582_912.0;
    /// (log 2)^k / k! for k = 1..=6.
    const TAYLOR: [f32; 6] = [
        std::f32::consts::LN_2,
        0.240_226_5,
        0.055_504_11,
        0.009_618_129,
        0.001_333_355_8,
        0.000_154_035_3,
    ];
    let scaled = x.max(-87.0) * std::f32::consts::LOG2_E;
    let rounded = scaled + ROUND;
    let f = scaled - (rounded - ROUND);
    let [c1, c2, c3, c4, c5, c6] = TAYLOR;
    let power = 1.0 + f * (c1 + f * (c2 + f * (c3 + f * (c4 + f * (c5 + f * c6)))));
    // The integer plus the exponent's bias of 127, moved to where the exponent is.
    f32::from_bits(rounded.to_bits().wrapping_add(127) << 23) * power
}

#[cfg(test)]
mod tests;
