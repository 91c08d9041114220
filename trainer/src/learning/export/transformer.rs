//! The decision transformer as an ONNX graph.

use crate::learning::algorithms::dt::{
    DEPTH, EPSILON, FIRST_BLOCK, NORM_IN, POSITION, RETURN, STATE, WIDTH, mask_values,
};
use crate::learning::error::TrainError;
use crate::learning::export::graphs::OBSERVATIONS;
use crate::learning::export::onnx::Graph;
use crate::learning::network::LayerParameters;

impl Graph {
    /// From standardised observations to `mean` and `log_std`.
    pub(super) fn transformer(&mut self, layers: &[LayerParameters<'_>]) -> Result<(), TrainError> {
        let frame_stack = layers[POSITION].shape.inputs;
        let tokens = 2 * frame_stack;
        let mut x = self.tokens(layers, frame_stack);
        x = self.norm(&layers[NORM_IN], &x);
        self.constant("mask", &[tokens as i64, tokens as i64], &mask_values(tokens));
        self.constant("root", &[], &[(WIDTH as f32).sqrt()]);
        for block in 0..DEPTH {
            let layers = &layers[FIRST_BLOCK + 6 * block..][..6];
            let seen = self.attention(&layers[0..3], &x);
            x = self.sum(&x, &seen);
            let normed = self.norm(&layers[3], &x);
            let inner = self.linear("", &layers[4], &normed);
            let active = format!("{inner}_active");
            self.node("Relu", &[&inner], &active);
            let outer = self.linear("", &layers[5], &active);
            x = self.sum(&x, &outer);
        }
        let last = self.slice(&x, 1, tokens - 1, 1);
        self.reshape(&last, "last", &[-1, WIDTH as i64]);
        let heads = &layers[FIRST_BLOCK + 6 * DEPTH..];
        let last = self.norm(&heads[0], "last");
        self.parameters("", &heads[1]);
        self.apply("", &heads[1], &last, "mean");
        let spread = self.linear("", &heads[2], &last);
        self.clip(&spread, "log_std");
        Ok(())
    }

    /// A return, which is the bias of its layer, and an observation for each frame: `[N, tokens, 128]`.
    fn tokens(&mut self, layers: &[LayerParameters<'_>], frame_stack: usize) -> String {
        let state = &layers[STATE];
        let frame_size = state.shape.inputs;
        // Both tokens of a frame in one product, side by side.
        let weight: Vec<f32> = state
            .weight
            .chunks_exact(WIDTH)
            .flat_map(|row| [0.0; WIDTH].iter().chain(row).copied().collect::<Vec<f32>>())
            .collect();
        let biases = [&layers[RETURN], state].map(|layer| layer.bias.unwrap_or_default());
        let positions: Vec<f32> = layers[POSITION]
            .weight
            .chunks_exact(WIDTH)
            .flat_map(|row| [row, row].concat())
            .collect();
        self.constant("tokens.weight", &[frame_size as i64, 2 * WIDTH as i64], &weight);
        self.constant("tokens.bias", &[2 * WIDTH as i64], &biases.concat());
        let tokens = [2 * frame_stack as i64, WIDTH as i64];
        self.constant("tokens.position", &tokens, &positions);
        self.reshape(OBSERVATIONS, "frames", &[-1, frame_size as i64]);
        self.node("MatMul", &["frames", "tokens.weight"], "tokens_product");
        self.node("Add", &["tokens_product", "tokens.bias"], "tokens_flat");
        self.reshape("tokens_flat", "tokens_apart", &[-1, tokens[0], tokens[1]]);
        self.node("Add", &["tokens_apart", "tokens.position"], "tokens");
        "tokens".to_owned()
    }

    /// Of norm, queries with keys and values, and output.
    fn attention(&mut self, layers: &[LayerParameters<'_>], x: &str) -> String {
        let normed = self.norm(&layers[0], x);
        let all = self.linear("", &layers[1], &normed);
        let [queries, keys, values] =
            [0, 1, 2].map(|part| self.slice(&all, 2, part * WIDTH, WIDTH));
        let name = |part: &str| format!("{all}_{part}");
        self.transpose(&keys, &name("keys"), &[0, 2, 1]);
        self.node("MatMul", &[&queries, &name("keys")], &name("products"));
        self.node("Div", &[&name("products"), "root"], &name("scores"));
        self.node("Add", &[&name("scores"), "mask"], &name("masked"));
        self.node("Softmax", &[&name("masked")], &name("weights"));
        self.node("MatMul", &[&name("weights"), &values], &name("seen"));
        self.linear("", &layers[2], &name("seen"))
    }

    fn norm(&mut self, layer: &LayerParameters<'_>, input: &str) -> String {
        let name = layer.shape.name;
        let (gain, bias) = (format!("{name}.gain"), format!("{name}.shift"));
        self.constant(&gain, &[WIDTH as i64], layer.weight);
        self.constant(&bias, &[WIDTH as i64], layer.bias.unwrap_or_default());
        self.layer_norm(&[input, &gain, &bias], name, EPSILON as f32);
        name.to_owned()
    }

    fn sum(&mut self, left: &str, right: &str) -> String {
        let output = format!("{right}_sum");
        self.node("Add", &[left, right], &output);
        output
    }

    fn reshape(&mut self, input: &str, output: &str, dims: &[i64]) {
        let shape = format!("{output}_shape");
        self.indices(&shape, dims);
        self.node("Reshape", &[input, &shape], output);
    }
}
