//! Normal numbers in bulk, many at a time.
//!
//! MINE draws millions of them a step. NumPy's ziggurat ([`palr_gym_core::random::Generator`])
//! takes them one by one; this generator takes 32 at a time with vector instructions.

use palr_gym_core::random::Generator;
use pulp::{Arch, Simd};

/// Generators side by side.
const LANES: usize = 16;
/// Numbers of a block: each lane's pair.
const BLOCK: usize = 2 * LANES;

/// Sixteen xoshiro128++ side by side, and Box and Muller's transform.
///
/// # Source
/// Blackman and Vigna (2021), xoshiro128++; its states are drawn from `Generator`. A block takes
/// two rounds, x and y: with u = (⌊x/2⁸⌋ + 1)/2²⁴ and v = ⌊y/2⁸⌋/2²⁴, its first sixteen numbers are
/// √(-2 log u) cos 2πv, the others √(-2 log u) sin 2πv. None is beyond ±5.77.
#[derive(Debug, Clone)]
pub struct Normals {
    state: [[u32; LANES]; 4],
}

impl Normals {
    /// A stream that follows from `generator`'s next 32 numbers: word k of the state of lane l is
    /// half number 16 k + l of them, the lower half first.
    #[must_use]
    pub fn new(generator: &mut Generator) -> Self {
        let mut state = [[0; LANES]; 4];
        for word in &mut state {
            for pair in word.chunks_exact_mut(2) {
                let bits = generator.next_u64();
                pair[0] = bits as u32;
                pair[1] = (bits >> 32) as u32;
            }
        }
        // The one state that yields nothing but zeros.
        for lane in 0..LANES {
            if state.iter().all(|word| word[lane] == 0) {
                state[0][lane] = 1;
            }
        }
        Self { state }
    }

    /// `count` numbers with standard deviation `std`, in whole blocks of the stream.
    #[must_use]
    pub fn draw(&mut self, count: usize, std: f64) -> Vec<f32> {
        let mut values = vec![0.0; count];
        self.add_to(&mut values, std);
        values
    }

    /// Adds a number with standard deviation `std` to each of `values`.
    pub fn add_to(&mut self, values: &mut [f32], std: f64) {
        add_normals(self, values, std as f32);
    }

    #[inline(always)]
    fn block(&mut self) -> [f32; BLOCK] {
        const UNIT: f32 = 1.0 / 16_777_216.0;
        let (x, y) = (self.round(), self.round());
        let mut numbers = [0.0; BLOCK];
        for lane in 0..LANES {
            let u = ((x[lane] >> 8) + 1) as f32 * UNIT;
            let radius = (-2.0 * ln(u)).sqrt();
            let (sin, cos) = sin_cos_turns((y[lane] >> 8) as f32 * UNIT);
            numbers[lane] = radius * cos;
            numbers[LANES + lane] = radius * sin;
        }
        numbers
    }

    #[inline(always)]
    fn round(&mut self) -> [u32; LANES] {
        let [s0, s1, s2, s3] = &mut self.state;
        let mut result = [0; LANES];
        for lane in 0..LANES {
            result[lane] = s0[lane].wrapping_add(s3[lane]).rotate_left(7).wrapping_add(s0[lane]);
            let shifted = s1[lane] << 9;
            s2[lane] ^= s0[lane];
            s3[lane] ^= s1[lane];
            s1[lane] ^= s2[lane];
            s0[lane] ^= s3[lane];
            s2[lane] ^= shifted;
            s3[lane] = s3[lane].rotate_left(11);
        }
        result
    }
}

#[pulp::with_simd(add_normals = Arch::new())]
#[inline(always)]
fn add_normals_with_simd<'a, S: Simd>(
    _simd: S,
    normals: &'a mut Normals,
    values: &'a mut [f32],
    std: f32,
) {
    let mut blocks = values.chunks_exact_mut(BLOCK);
    for block in &mut blocks {
        let numbers = normals.block();
        for (value, number) in block.iter_mut().zip(numbers) {
            *value += std * number;
        }
    }
    let rest = blocks.into_remainder();
    if !rest.is_empty() {
        let numbers = normals.block();
        for (value, number) in rest.iter_mut().zip(numbers) {
            *value += std * number;
        }
    }
}

/// The natural logarithm of a normal number in (0, 1], to 3e-7 of the value or 1e-7.
///
/// # Source
/// u = 2^e m with m in [√½, √2); log m = 2 artanh s with s = (m - 1) / (m + 1), by its series.
#[inline(always)]
fn ln(u: f32) -> f32 {
    /// Bits of √½.
    const ROOT_HALF: u32 = 0x3f35_04f3;
    let bits = u.to_bits().wrapping_sub(ROOT_HALF);
    let exponent = (bits as i32) >> 23;
    let m = f32::from_bits((bits & 0x007f_ffff).wrapping_add(ROOT_HALF));
    let s = (m - 1.0) / (m + 1.0);
    let t = s * s;
    let series = 2.0 * s * (1.0 + t * (1.0 / 3.0 + t * (1.0 / 5.0 + t * (1.0 / 7.0 + t / 9.0))));
    exponent as f32 * std::f32::consts::LN_2 + series
}

/// Sine and cosine of `turns` · 2π, for 0 to 1, to 2e-7.
///
/// # Source
/// Taylor's polynomials within an eighth of a turn around the nearest quarter.
#[inline(always)]
fn sin_cos_turns(turns: f32) -> (f32, f32) {
    let quarter = (turns * 4.0 + 0.5) as i32;
    let angle = (turns - quarter as f32 * 0.25) * std::f32::consts::TAU;
    let t = angle * angle;
    let sin = angle * (1.0 - t / 6.0 * (1.0 - t / 20.0 * (1.0 - t / 42.0 * (1.0 - t / 72.0))));
    let cos = 1.0 - t / 2.0 * (1.0 - t / 12.0 * (1.0 - t / 30.0 * (1.0 - t / 56.0)));
    let (a, b) = if quarter & 1 == 1 { (cos, sin) } else { (sin, cos) };
    let sin = if quarter & 2 == 2 { -a } else { a };
    let cos = if (quarter + 1) & 2 == 2 { -b } else { b };
    (sin, cos)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logarithm_sine_and_cosine_are_those_of_double_precision() {
        for i in 1..=16_384_u32 {
            let u = (i * 1024) as f32 / 16_777_216.0;
            let want = f64::from(u).ln();
            assert!((f64::from(ln(u)) - want).abs() < 3e-7 * want.abs() + 1e-7, "{u}");
            let turns = (i * 1024 - 1) as f32 / 16_777_216.0;
            let (sin, cos) = sin_cos_turns(turns);
            let angle = f64::from(turns) * std::f64::consts::TAU;
            assert!((f64::from(sin) - angle.sin()).abs() < 4e-7, "{turns}: {sin}");
            assert!((f64::from(cos) - angle.cos()).abs() < 4e-7, "{turns}: {cos}");
        }
        assert_eq!(ln(1.0), 0.0);
        let smallest = f64::from(ln(1.0 / 16_777_216.0));
        assert!((smallest + 24.0 * std::f64::consts::LN_2).abs() < 1e-5, "{smallest}");
    }

    #[test]
    fn numbers_are_normal_uncorrelated_and_follow_from_the_generator() {
        let draw = |seed, count| Normals::new(&mut Generator::from_seed(seed)).draw(count, 2.0);
        let count = 1 << 18;
        let numbers = draw(1, count);
        assert_eq!(numbers[..100], draw(1, 100));
        assert_ne!(numbers[..100], draw(2, 100));
        let mean_of = |f: &dyn Fn(usize) -> f64| (0..count - 64).map(f).sum::<f64>() / count as f64;
        let z = |i: usize| f64::from(numbers[i]) / 2.0;
        // Within five standard errors each: of the first four moments, and of products at the
        // distances where lanes or halves of a block would meet.
        let error = 5.0 / (count as f64).sqrt();
        assert!(mean_of(&z).abs() < error);
        assert!((mean_of(&|i| z(i).powi(2)) - 1.0).abs() < error * 2.0_f64.sqrt() + 1e-4);
        assert!(mean_of(&|i| z(i).powi(3)).abs() < error * 15.0_f64.sqrt());
        assert!((mean_of(&|i| z(i).powi(4)) - 3.0).abs() < error * 96.0_f64.sqrt() + 3e-4);
        for distance in [1, 2, 15, 16, 17, 31, 32, 33, 64] {
            assert!(mean_of(&|i| z(i) * z(i + distance)).abs() < error, "{distance}");
            let squares = mean_of(&|i| (z(i).powi(2) - 1.0) * (z(i + distance).powi(2) - 1.0));
            assert!(squares.abs() < 2.0 * error, "{distance}: {squares}");
        }
        let beyond = mean_of(&|i| f64::from(u8::from(z(i).abs() > 1.959_964)));
        assert!((beyond - 0.05).abs() < 0.22 * error + 1e-5, "{beyond}");
    }
}
