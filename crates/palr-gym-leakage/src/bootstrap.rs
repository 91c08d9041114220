//! An interval for a mean of dependent terms.
//!
//! Consecutive samples of an episode resemble each other, so single terms must not be resampled as
//! if they were independent; and resampling rows and fitting again would put duplicates into the
//! kernel regression and bias it. So the terms that the estimate is a mean of are resampled in
//! blocks, with the embedding held fixed.

use palr_gym_core::random::Generator;

use crate::error::LeakageError;

/// From this many episodes on, whole episodes are the blocks.
pub const MIN_EPISODES: usize = 20;

/// A percentile interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
    /// True if whole episodes were the blocks, false for moving blocks of fixed length.
    pub is_by_episode: bool,
}

/// 95 % bootstrap interval of the mean of `terms`.
///
/// `episode_lengths` sum to the number of terms. With at least [`MIN_EPISODES`] of them whole
/// episodes are resampled; with fewer, moving blocks of ⌈√n⌉ consecutive terms (which may cross an
/// episode's end). Equal input and seed give equal intervals.
///
/// # Errors
/// [`LeakageError::Blocks`] if the lengths do not add up, [`LeakageError::TooFew`] without terms.
pub fn block_bootstrap(
    terms: &[f64],
    episode_lengths: &[usize],
    resamples: usize,
    seed: u64,
) -> Result<Interval, LeakageError> {
    let (got, want) = (episode_lengths.iter().sum(), terms.len());
    if got != want {
        return Err(LeakageError::Blocks { got, want });
    }
    if terms.is_empty() || resamples == 0 {
        return Err(LeakageError::TooFew { got: terms.len() });
    }
    let is_by_episode = episode_lengths.len() >= MIN_EPISODES;
    let blocks = if is_by_episode { episodes(episode_lengths) } else { moving(terms.len()) };
    // Sums up to each term make a block's sum one subtraction.
    let mut running = vec![0.0; terms.len() + 1];
    for (i, term) in terms.iter().enumerate() {
        running[i + 1] = running[i] + term;
    }
    let mut generator = Generator::from_seed(seed);
    let mut means: Vec<f64> = (0..resamples)
        .map(|_| {
            let (mut sum, mut count) = (0.0, 0);
            while count < terms.len() {
                let pick = (generator.next_f64() * blocks.len() as f64) as usize;
                let (start, end) = blocks[pick];
                sum += running[end] - running[start];
                count += end - start;
            }
            sum / count as f64
        })
        .collect();
    means.sort_by(f64::total_cmp);
    let at = |quantile: f64| means[(quantile * (resamples - 1) as f64).round() as usize];
    Ok(Interval { low: at(0.025), high: at(0.975), is_by_episode })
}

fn episodes(lengths: &[usize]) -> Vec<(usize, usize)> {
    lengths
        .iter()
        .scan(0, |start, &length| {
            let block = (*start, *start + length);
            *start += length;
            Some(block)
        })
        .filter(|(start, end)| end > start)
        .collect()
}

fn moving(count: usize) -> Vec<(usize, usize)> {
    let length = (count as f64).sqrt().ceil() as usize;
    (0..=count - length).map(|start| (start, start + length)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Terms with autocorrelation ρ per step within episodes of `length`.
    fn autoregressive(episodes: usize, length: usize, rho: f64, seed: u64) -> Vec<f64> {
        let mut generator = Generator::from_seed(seed);
        let mut terms = Vec::new();
        for _ in 0..episodes {
            let mut value = generator.standard_normal();
            for _ in 0..length {
                terms.push(value);
                value = rho * value + (1.0 - rho * rho).sqrt() * generator.standard_normal();
            }
        }
        terms
    }

    #[test]
    fn intervals_of_dependent_terms_cover_their_mean_as_often_as_they_claim() {
        for (episodes, length) in [(40, 25), (5, 400)] {
            let covered = (0..200)
                .filter(|&seed| {
                    let terms = autoregressive(episodes, length, 0.8, seed);
                    let lengths = vec![length; episodes];
                    let interval = block_bootstrap(&terms, &lengths, 400, seed).unwrap();
                    assert_eq!(interval.is_by_episode, episodes >= MIN_EPISODES);
                    interval.low <= 0.0 && 0.0 <= interval.high
                })
                .count();
            // 95 % of 200 is 190; binomial deviation 3. Resampling single terms covers about 120.
            assert!((175..=200).contains(&covered), "{covered} of 200 for {episodes} episodes");
        }
    }

    #[test]
    fn lengths_must_add_up_and_equal_seeds_give_equal_intervals() {
        let error = block_bootstrap(&[1.0, 2.0], &[1], 10, 0).unwrap_err();
        assert_eq!(error.to_string(), "blocks hold 1 samples; expected 2");
        assert!(block_bootstrap(&[], &[], 10, 0).is_err());
        let terms = autoregressive(30, 10, 0.5, 1);
        let interval = |seed| block_bootstrap(&terms, &[10; 30], 500, seed).unwrap();
        assert_eq!(interval(3), interval(3));
        assert_ne!(interval(3), interval(4));
    }
}
