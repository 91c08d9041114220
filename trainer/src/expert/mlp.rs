//! Networks with ReLU between their layers, forward and backward by hand.
//!
//! An update of an actor and its critics is some twenty small products; an autodiff graph around
//! each of them costs as much as the products do.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use pulp::{Arch, Simd};

use crate::learning::network::LayerShape;

/// What a pass leaves behind for its way back.
#[derive(Debug, Clone, Default)]
pub struct Tape {
    n: usize,
    /// Of each layer, `[n, outputs]`; of hidden ones after ReLU.
    outputs: Vec<Vec<f32>>,
    /// Scratch of the way back.
    gradient: Vec<f32>,
    next_gradient: Vec<f32>,
}

impl Tape {
    /// What the last layer gave, `[n, outputs]`.
    #[must_use]
    pub fn output(&self) -> &[f32] {
        self.outputs.last().map_or(&[], Vec::as_slice)
    }
}

/// Which gradients a way back is for.
#[derive(Debug)]
pub enum Wanted<'a> {
    /// Of the parameters, in the order of the flat vector.
    Parameters(&'a mut [f32]),
    /// Of the input, `[n, inputs]`.
    Input(&'a mut Vec<f32>),
}

/// Runs `layers` on `input`, `[n, inputs of the first layer]`.
///
/// # Panics
/// If the slices have not the lengths that `layers` and `n` say.
pub fn forward(
    layers: &[LayerShape],
    parameters: &[f32],
    input: &[f32],
    n: usize,
    tape: &mut Tape,
) {
    tape.n = n;
    tape.outputs.resize_with(layers.len(), Vec::new);
    let mut start = 0;
    for (at, layer) in layers.iter().enumerate() {
        let (before, rest) = tape.outputs.split_at_mut(at);
        let input = before.last().map_or(input, Vec::as_slice);
        let output = &mut rest[0];
        output.resize(n * layer.outputs, 0.0);
        let (weight, bias) =
            parameters[start..start + layer.len()].split_at(layer.inputs * layer.outputs);
        // A row-major matrix is its transpose column by column: out' = weight' input'.
        matmul(
            MatMut::from_column_major_slice_mut(output, layer.outputs, n),
            Accum::Replace,
            MatRef::from_column_major_slice(weight, layer.outputs, layer.inputs),
            MatRef::from_column_major_slice(input, layer.inputs, n),
            1.0,
            Par::Seq,
        );
        let is_hidden = at + 1 < layers.len();
        activate(output, bias, is_hidden);
        start += layer.len();
    }
}

/// Adds the bias to each row of a layer's output; what `is_hidden` goes through ReLU.
#[pulp::with_simd(activate = Arch::new())]
#[inline(always)]
fn activate_with_simd<'a, S: Simd>(
    _simd: S,
    output: &'a mut [f32],
    bias: &'a [f32],
    is_hidden: bool,
) {
    for row in output.chunks_exact_mut(bias.len()) {
        for (value, bias) in row.iter_mut().zip(bias) {
            let sum = *value + bias;
            *value = if is_hidden { sum.max(0.0) } else { sum };
        }
    }
}

/// The sum of the rows of `gradient`.
#[pulp::with_simd(sum_rows = Arch::new())]
#[inline(always)]
fn sum_rows_with_simd<'a, S: Simd>(_simd: S, gradient: &'a [f32], sums: &'a mut [f32]) {
    sums.fill(0.0);
    for row in gradient.chunks_exact(sums.len()) {
        for (sum, value) in sums.iter_mut().zip(row) {
            *sum += value;
        }
    }
}

/// The way back of ReLU.
#[pulp::with_simd(relu_backward = Arch::new())]
#[inline(always)]
fn relu_backward_with_simd<'a, S: Simd>(_simd: S, gradient: &'a mut [f32], output: &'a [f32]) {
    for (value, output) in gradient.iter_mut().zip(output) {
        *value = if *output > 0.0 { *value } else { 0.0 };
    }
}

/// The way back of [`forward`] with the same arguments, from `output_gradient`, `[n, outputs]`.
///
/// # Panics
/// As [`forward`].
pub fn backward(
    layers: &[LayerShape],
    parameters: &[f32],
    input: &[f32],
    tape: &mut Tape,
    output_gradient: &[f32],
    mut wanted: Wanted<'_>,
) {
    let n = tape.n;
    let Tape { outputs, gradient, next_gradient, .. } = tape;
    gradient.clear();
    gradient.extend_from_slice(output_gradient);
    let mut end = parameters.len();
    for (at, layer) in layers.iter().enumerate().rev() {
        let start = end - layer.len();
        let weights = layer.inputs * layer.outputs;
        let rows = MatRef::from_column_major_slice(gradient, layer.outputs, n);
        if let Wanted::Parameters(flat) = &mut wanted {
            let layer_input = if at == 0 { input } else { &outputs[at - 1] };
            let (weight, bias) = flat[start..end].split_at_mut(weights);
            matmul(
                MatMut::from_column_major_slice_mut(weight, layer.outputs, layer.inputs),
                Accum::Replace,
                rows,
                MatRef::from_column_major_slice(layer_input, layer.inputs, n).transpose(),
                1.0,
                Par::Seq,
            );
            sum_rows(gradient, bias);
        }
        if at == 0 && matches!(wanted, Wanted::Parameters(_)) {
            return;
        }
        next_gradient.resize(n * layer.inputs, 0.0);
        let weight = &parameters[start..start + weights];
        matmul(
            MatMut::from_column_major_slice_mut(next_gradient, layer.inputs, n),
            Accum::Replace,
            MatRef::from_column_major_slice(weight, layer.outputs, layer.inputs).transpose(),
            rows,
            1.0,
            Par::Seq,
        );
        if at > 0 {
            relu_backward(next_gradient, &outputs[at - 1]);
        }
        std::mem::swap(gradient, next_gradient);
        end = start;
    }
    if let Wanted::Input(input_gradient) = wanted {
        input_gradient.clear();
        input_gradient.extend_from_slice(gradient);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learning::network::{Initialization, Network};

    /// Σ coefficients · output, in double precision.
    fn exact(
        layers: &[LayerShape],
        parameters: &[f64],
        input: &[f64],
        coefficients: &[f64],
    ) -> f64 {
        let n = input.len() / layers[0].inputs;
        let mut rows = input.to_vec();
        let mut start = 0;
        for (at, layer) in layers.iter().enumerate() {
            let (weight, bias) =
                parameters[start..start + layer.len()].split_at(layer.inputs * layer.outputs);
            let mut out = Vec::new();
            for row in rows.chunks_exact(layer.inputs) {
                let sum = |column: usize| {
                    let products = row.iter().enumerate();
                    let products = products.map(|(k, v)| v * weight[k * layer.outputs + column]);
                    products.sum::<f64>() + bias[column]
                };
                let mut sums: Vec<f64> = (0..layer.outputs).map(sum).collect();
                if at + 1 < layers.len() {
                    sums.iter_mut().for_each(|sum| *sum = sum.max(0.0));
                }
                out.extend(sums);
            }
            rows = out;
            start += layer.len();
        }
        assert_eq!(rows.len() % n, 0);
        rows.iter().zip(coefficients).map(|(value, coefficient)| value * coefficient).sum()
    }

    #[test]
    fn values_and_gradients_are_those_of_double_precision_and_finite_differences() {
        let layers = vec![
            LayerShape::new("a", 5, 7),
            LayerShape::new("b", 7, 6),
            LayerShape::new("c", 6, 3),
        ];
        let network = Network::new("n", layers.clone(), Initialization::Uniform, 3, 0);
        let n = 4;
        let input: Vec<f32> = (0..n * 5).map(|i| (i as f32 * 1.7).sin()).collect();
        let coefficients: Vec<f32> = (0..n * 3).map(|i| (i as f32 * 0.9).cos()).collect();
        let wide = |values: &[f32]| values.iter().map(|&v| f64::from(v)).collect::<Vec<f64>>();
        let (parameters, input_64) = (wide(&network.parameters), wide(&input));
        let coefficients_64 = wide(&coefficients);

        let mut tape = Tape::default();
        forward(&layers, &network.parameters, &input, n, &mut tape);
        let sum: f64 = wide(tape.output()).iter().zip(&coefficients_64).map(|(a, b)| a * b).sum();
        assert!((sum - exact(&layers, &parameters, &input_64, &coefficients_64)).abs() < 1e-5);

        let mut gradient = vec![0.0; parameters.len()];
        let wanted = Wanted::Parameters(&mut gradient);
        backward(&layers, &network.parameters, &input, &mut tape, &coefficients, wanted);
        let mut input_gradient = Vec::new();
        let wanted = Wanted::Input(&mut input_gradient);
        backward(&layers, &network.parameters, &input, &mut tape, &coefficients, wanted);
        let step = 1e-6;
        let difference = |shift: &dyn Fn(f64) -> (Vec<f64>, Vec<f64>)| {
            let at = |by| {
                let (parameters, input) = shift(by);
                exact(&layers, &parameters, &input, &coefficients_64)
            };
            (at(step) - at(-step)) / (2.0 * step)
        };
        for (i, &got) in gradient.iter().enumerate() {
            let want = difference(&|by| {
                let mut shifted = parameters.clone();
                shifted[i] += by;
                (shifted, input_64.clone())
            });
            assert!((f64::from(got) - want).abs() < 1e-5, "parameter {i}: {got} {want}");
        }
        for (i, &got) in input_gradient.iter().enumerate() {
            let want = difference(&|by| {
                let mut shifted = input_64.clone();
                shifted[i] += by;
                (parameters.clone(), shifted)
            });
            assert!((f64::from(got) - want).abs() < 1e-5, "input {i}: {got} {want}");
        }
    }
}
