//! Random numbers of a run: a stream of its own for each purpose and step.
//!
//! A step's numbers follow from the seed and the step's number alone, so that there is no generator
//! to save: a resumed run draws what the uninterrupted one would have drawn, and nothing that is
//! drawn elsewhere can shift them.

use palr_gym_core::random::Generator;

/// What numbers are for. The discriminants are part of what a seed means.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Purpose {
    /// One stream a network.
    InitialParameters = 1,
    /// One a step.
    Batch = 2,
    /// One a batch of the pool.
    PoolBatch = 3,
    /// What a step draws besides rows.
    Noise = 4,
    /// What a finished policy keeps.
    Policy = 5,
    /// KF's first stage.
    Predictor = 6,
    /// What an expert in training tries out: one a round of its environments.
    Exploration = 7,
    /// What its actuators are pushed with: one a round.
    Perturbation = 8,
    /// Rows of a step's inner updates: the update's number is added.
    InnerBatch = 1000,
    /// What inner updates draw besides rows: the update's number is added.
    InnerNoise = 2000,
}

/// The stream number `index` of `purpose`.
pub(crate) fn stream(seed: u64, purpose: Purpose, index: u32) -> Generator {
    inner_stream(seed, purpose, 0, index)
}

/// The stream number `index` of inner update number `update`, below 1000, of `purpose`.
pub(crate) fn inner_stream(seed: u64, purpose: Purpose, update: u32, index: u32) -> Generator {
    // Both halves of the stream's number are words of NumPy's seed sequence; the upper one is never
    // 0, so the words of two pairs (seed, stream) never coincide.
    let upper = purpose as u64 + u64::from(update);
    Generator::from_seed_and_stream(seed, upper << 32 | u64::from(index))
}

/// `count` of the rows 0..n, with replacement.
pub(crate) fn draw_rows(generator: &mut Generator, n: usize, count: usize) -> Vec<usize> {
    (0..count).map(|_| ((generator.next_f64() * n as f64) as usize).min(n - 1)).collect()
}

/// The numbers 0..n in random order (Fisher and Yates, from the end).
pub(crate) fn permutation(generator: &mut Generator, n: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..n).collect();
    for last in (1..n).rev() {
        let other = ((generator.next_f64() * (last + 1) as f64) as usize).min(last);
        order.swap(last, other);
    }
    order
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
            first(Purpose::InnerBatch, 0),
            inner_stream(7, Purpose::InnerBatch, 1, 0).next_u64(),
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
