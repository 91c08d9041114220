//! Normal numbers by the ziggurat method of Marsaglia and Tsang, with 256 layers as in NumPy.

mod tables;

use self::tables::{F, K, W};
use super::Generator;

/// Where the tail begins.
const TAIL: f64 = 3.654_152_885_361_009;
const INVERSE_TAIL: f64 = 0.273_661_237_329_758_3;

pub(super) fn standard_normal(generator: &mut Generator) -> f64 {
    loop {
        let bits = generator.next_u64();
        let layer = (bits & 0xff) as usize;
        let is_negative = (bits >> 8) & 1 == 1;
        let magnitude = (bits >> 9) & 0x000f_ffff_ffff_ffff;
        let x = magnitude as f64 * f64::from_bits(W[layer]);
        let x = if is_negative { -x } else { x };
        // 99 % of the draws end here: the point lies inside the layer's rectangle.
        if magnitude < K[layer] {
            return x;
        }
        if layer == 0 {
            // The tail's sign is a bit of the magnitude, not the sign bit, as in NumPy.
            return tail(generator, (magnitude >> 8) & 1 == 1);
        }
        let (above, below) = (f64::from_bits(F[layer - 1]), f64::from_bits(F[layer]));
        if (above - below) * generator.next_f64() + below < (-0.5 * x * x).exp() {
            return x;
        }
    }
}

fn tail(generator: &mut Generator, is_negative: bool) -> f64 {
    loop {
        let x = -INVERSE_TAIL * (-generator.next_f64()).ln_1p();
        let y = -(-generator.next_f64()).ln_1p();
        if y + y > x * x {
            let magnitude = TAIL + x;
            return if is_negative { -magnitude } else { magnitude };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The tables are data; this is what they mean.
    #[test]
    fn tables_are_the_layers_of_a_normal_density() {
        let scale = 2.0_f64.powi(52);
        let x = |layer: usize| if layer == 0 { 0.0 } else { f64::from_bits(W[layer]) * scale };
        assert_eq!(x(255), TAIL);
        for layer in 1..256 {
            let density = (-0.5 * x(layer).powi(2)).exp();
            assert!((f64::from_bits(F[layer]) / density - 1.0).abs() < 1e-14, "F[{layer}]");
            let ratio = x(layer - 1) / x(layer) * scale;
            assert!((K[layer] as f64 - ratio).abs() <= 64.0, "K[{layer}]");
        }
    }
}
