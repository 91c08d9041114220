//! Random numbers of a run: a stream of its own for each purpose and step.
//!
//! A step's numbers follow from the seed and the step's number alone, so that there is no generator
//! to save: a resumed run draws what the uninterrupted one would have drawn, and nothing that is
//! drawn elsewhere can shift them.

use palr_gym_core::random::Generator;

/// What numbers are for. The discriminants are part of what a seed means.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Purpose {
    InitialParameters = 1,
    Batch = 2,
    PoolBatch = 3,
}

/// The stream number `index` of `purpose`.
pub(crate) fn stream(seed: u64, purpose: Purpose, index: u32) -> Generator {
    // Both halves of the stream's number are words of NumPy's seed sequence; the upper one is never
    // 0, so the words of two pairs (seed, stream) never coincide.
    Generator::from_seed_and_stream(seed, (purpose as u64) << 32 | u64::from(index))
}

/// `count` of the rows 0..n, with replacement.
pub(crate) fn draw_rows(generator: &mut Generator, n: usize, count: usize) -> Vec<usize> {
    (0..count).map(|_| ((generator.next_f64() * n as f64) as usize).min(n - 1)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn purposes_and_indices_have_streams_of_their_own_and_rows_are_uniform() {
        let first = |purpose, index| stream(7, purpose, index).next_u64();
        let numbers = [
            first(Purpose::InitialParameters, 0),
            first(Purpose::Batch, 0),
            first(Purpose::Batch, 1),
            first(Purpose::PoolBatch, 0),
        ];
        for (i, number) in numbers.iter().enumerate() {
            assert!(!numbers[..i].contains(number));
        }
        let rows = draw_rows(&mut stream(7, Purpose::Batch, 0), 4, 4000);
        for row in 0..4 {
            let count = rows.iter().filter(|&&drawn| drawn == row).count();
            // Five standard deviations of a binomial with n = 4000, p = 1/4.
            assert!((863..=1137).contains(&count), "{row}: {count}");
        }
    }
}
