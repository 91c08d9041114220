//! NumPy's generator: `Generator(PCG64(SeedSequence(seed)))`, bit for bit.
//!
//! Environments are reset from it so that a seed means here what it means to Gymnasium. It also
//! serves everything else that must be seeded (random policies, sampled actions, bootstraps).
//! Constants and algorithms are those of O'Neill's PCG paper and of NumPy's documented streams;
//! the tests compare with NumPy's own output.

mod seed_sequence;
mod ziggurat;

/// Multiplier of the 128-bit congruential generator inside PCG64.
const MULTIPLIER: u128 = 0x2360_ed05_1fc6_5da4_4385_df64_9fcc_f645;

/// A seeded stream of random numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Generator {
    state: u128,
    increment: u128,
}

impl Generator {
    /// The stream of `numpy.random.default_rng(seed)`.
    #[must_use]
    pub fn from_seed(seed: u64) -> Self {
        Self::from_entropy(&seed_sequence::words(seed))
    }

    /// A stream of its own for each `(seed, stream)`: `default_rng([seed, stream])`.
    #[must_use]
    pub fn from_seed_and_stream(seed: u64, stream: u64) -> Self {
        let mut entropy = seed_sequence::words(seed);
        entropy.extend(seed_sequence::words(stream));
        Self::from_entropy(&entropy)
    }

    fn from_entropy(entropy: &[u32]) -> Self {
        let [s0, s1, i0, i1] = seed_sequence::generate_state(entropy);
        let join = |high: u64, low: u64| (u128::from(high) << 64) | u128::from(low);
        let mut generator = Self { state: 0, increment: (join(i0, i1) << 1) | 1 };
        generator.advance();
        generator.state = generator.state.wrapping_add(join(s0, s1));
        generator.advance();
        generator
    }

    /// Where the stream stands: NumPy's `state` and `inc`.
    #[must_use]
    pub fn state(&self) -> (u128, u128) {
        (self.state, self.increment)
    }

    /// The stream that stands at `(state, increment)`; `None` if the increment is even, which no
    /// stream's is.
    #[must_use]
    pub fn from_state(state: u128, increment: u128) -> Option<Self> {
        (increment % 2 == 1).then_some(Self { state, increment })
    }

    fn advance(&mut self) {
        self.state = self.state.wrapping_mul(MULTIPLIER).wrapping_add(self.increment);
    }

    /// The next 64 random bits.
    pub fn next_u64(&mut self) -> u64 {
        self.advance();
        let folded = (self.state >> 64) as u64 ^ self.state as u64;
        folded.rotate_right((self.state >> 122) as u32)
    }

    /// Uniform in [0, 1), with 53 bits: `Generator.random()`.
    pub fn next_f64(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 * (1.0 / 9_007_199_254_740_992.0)
    }

    /// Uniform in [low, high): `Generator.uniform(low, high)`.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next_f64()
    }

    /// Normal with mean 0 and deviation 1: `Generator.standard_normal()`.
    pub fn standard_normal(&mut self) -> f64 {
        ziggurat::standard_normal(self)
    }
}

#[cfg(test)]
mod tests;
