//! What a data set is like, in numbers that decide whether methods can be told apart on it.

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};

use ndarray::ArrayView1;

use crate::error::DataError;
use crate::recording::{Outline, Recording, Rows};

/// Actions at least this large count as saturated: tanh of them is past 3.8.
pub const SATURATED: f32 = 0.999;

/// Equal parts of [-1, 1] in the histogram of an entry of the action.
pub const BINS: usize = 40;

/// Of a list of numbers; of one number the deviation is 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Standard deviation, divided by n.
    pub std: f64,
    /// Least.
    pub min: f64,
    /// Greatest.
    pub max: f64,
}

impl Spread {
    /// Of `values`, at least one.
    #[must_use]
    pub fn of(values: &[f64]) -> Self {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / n;
        let fold = |start: f64, pick: fn(f64, f64) -> f64| values.iter().copied().fold(start, pick);
        Self {
            mean,
            std: variance.sqrt(),
            min: fold(f64::INFINITY, f64::min),
            max: fold(f64::NEG_INFINITY, f64::max),
        }
    }
}

/// Of one entry of the action.
#[derive(Debug, Clone, PartialEq)]
pub struct ActionStatistics {
    /// Over all rows.
    pub spread: Spread,
    /// Share of rows with |action| ≥ [`SATURATED`].
    pub saturated: f64,
    /// Rows with an action of exactly ± 1: atanh of them is infinite.
    pub at_bound: usize,
    /// Correlation with the action before it, within episodes; none if one of both never varies.
    /// Near 1, a policy that repeats its past action looks good offline.
    pub lag_1_correlation: Option<f64>,
    /// Rows in each of [`BINS`] equal parts of [-1, 1].
    pub histogram: [u64; BINS],
}

/// Of a data set.
#[derive(Debug, Clone, PartialEq)]
pub struct Statistics {
    /// Undiscounted return of each episode.
    pub returns: Vec<f64>,
    /// Transitions of each episode.
    pub lengths: Vec<usize>,
    /// Episodes that the task ended.
    pub terminated: usize,
    /// Episodes that the time limit ended.
    pub timed_out: usize,
    /// Of each entry of the action.
    pub actions: Vec<ActionStatistics>,
    /// Rows whose observation came before, bit for bit.
    pub repeated_observations: usize,
    /// Those of them with another action than the first (the paper's D.2): no deterministic policy
    /// can do both.
    pub conflicting_actions: usize,
}

impl Statistics {
    /// Of all of `recording`, which passes through memory twice, block by block. What is kept of each
    /// row is 24 bytes, to tell repeated observations (by hashes of 128 bits).
    ///
    /// # Errors
    /// Those of [`Recording::rows`].
    pub fn of(recording: &dyn Recording) -> Result<Self, DataError> {
        let outline = recording.outline();
        let mut actions = vec![Sums::default(); outline.action_size];
        let mut returns = vec![0.0; outline.episodes.len()];
        let mut repeats = Repeats::default();
        let mut walk = Walk::new(outline);
        recording.for_each_block(&mut |_, rows| {
            walk.rows(rows, |row| {
                returns[row.episode] += f64::from(row.reward);
                repeats.add(row.observation, row.action);
                for (j, sums) in actions.iter_mut().enumerate() {
                    sums.add(row.action[j], row.past_action.map(|action| action[j]));
                }
            });
            Ok(())
        })?;
        let n = outline.transitions() as f64;
        let mut deviations = vec![Deviations::default(); outline.action_size];
        let mut walk = Walk::new(outline);
        recording.for_each_block(&mut |_, rows| {
            walk.rows(rows, |row| {
                for (j, (sums, deviations)) in actions.iter().zip(&mut deviations).enumerate() {
                    deviations.add(sums, n, row.action[j], row.past_action.map(|past| past[j]));
                }
            });
            Ok(())
        })?;
        let entries = actions.into_iter().zip(deviations);
        Ok(Self {
            returns,
            lengths: outline.episodes.iter().map(ExactSizeIterator::len).collect(),
            terminated: outline.terminated,
            timed_out: outline.timed_out,
            actions: entries.map(|(sums, deviations)| sums.finish(deviations, n)).collect(),
            repeated_observations: repeats.repeated,
            conflicting_actions: repeats.conflicting,
        })
    }
}

/// Evenly spaced actions, `count` of them or all, row by row: `[rows, A]`.
///
/// # Errors
/// Those of [`Recording::rows`].
pub fn evenly_spaced_actions(
    recording: &dyn Recording,
    count: usize,
) -> Result<Vec<Vec<f32>>, DataError> {
    let n = recording.outline().transitions();
    let rows = n.min(count);
    let mut chosen = Vec::with_capacity(rows);
    recording.for_each_block(&mut |first, block| {
        let end = first + block.rewards.len();
        while chosen.len() < rows && chosen.len() * n / rows < end {
            let row = chosen.len() * n / rows - first;
            chosen.push(block.actions.row(row).to_vec());
        }
        Ok(())
    })?;
    Ok(chosen)
}

/// A transition, with where it stands.
struct Row<'a> {
    episode: usize,
    observation: ArrayView1<'a, f32>,
    action: &'a [f32],
    /// None in the first row of an episode.
    past_action: Option<&'a [f32]>,
    reward: f32,
}

/// Goes through blocks of rows and remembers what reaches from one into the next.
struct Walk<'a> {
    outline: &'a Outline,
    row: usize,
    episode: usize,
    past_action: Vec<f32>,
}

impl<'a> Walk<'a> {
    fn new(outline: &'a Outline) -> Self {
        Self { outline, row: 0, episode: 0, past_action: vec![0.0; outline.action_size] }
    }

    fn rows(&mut self, rows: &Rows<'_>, mut visit: impl FnMut(Row<'_>)) {
        let mut action = vec![0.0; self.past_action.len()];
        for (at, &reward) in rows.rewards.iter().enumerate() {
            let episodes = &self.outline.episodes;
            self.episode += usize::from(self.row >= episodes[self.episode].end);
            let is_first = self.row == episodes[self.episode].start;
            for (value, &entry) in action.iter_mut().zip(rows.actions.row(at)) {
                *value = entry;
            }
            visit(Row {
                episode: self.episode,
                observation: rows.observations.row(at),
                action: &action,
                past_action: (!is_first).then_some(&self.past_action[..]),
                reward,
            });
            std::mem::swap(&mut self.past_action, &mut action);
            self.row += 1;
        }
    }
}

/// Of an entry of the action, after the first pass.
#[derive(Debug, Clone)]
struct Sums {
    sum: f64,
    min: f64,
    max: f64,
    saturated: usize,
    at_bound: usize,
    pairs: usize,
    sum_past: f64,
    sum_present: f64,
    histogram: [u64; BINS],
}

impl Default for Sums {
    fn default() -> Self {
        Self {
            sum: 0.0,
            min: f64::INFINITY,
            max: f64::NEG_INFINITY,
            saturated: 0,
            at_bound: 0,
            pairs: 0,
            sum_past: 0.0,
            sum_present: 0.0,
            histogram: [0; BINS],
        }
    }
}

impl Sums {
    fn add(&mut self, value: f32, past: Option<f32>) {
        let wide = f64::from(value);
        self.sum += wide;
        (self.min, self.max) = (self.min.min(wide), self.max.max(wide));
        self.saturated += usize::from(value.abs() >= SATURATED);
        self.at_bound += usize::from(value.abs() == 1.0);
        let bin = ((wide + 1.0) / 2.0 * BINS as f64) as usize;
        self.histogram[bin.min(BINS - 1)] += 1;
        if let Some(past) = past {
            self.pairs += 1;
            self.sum_past += f64::from(past);
            self.sum_present += wide;
        }
    }

    fn finish(self, deviations: Deviations, n: f64) -> ActionStatistics {
        let Deviations { square, xy, xx, yy } = deviations;
        let scale = (xx * yy).sqrt();
        ActionStatistics {
            spread: Spread {
                mean: self.sum / n,
                std: (square / n).sqrt(),
                min: self.min,
                max: self.max,
            },
            saturated: self.saturated as f64 / n,
            at_bound: self.at_bound,
            lag_1_correlation: (scale > 0.0).then(|| xy / scale),
            histogram: self.histogram,
        }
    }
}

/// Of an entry of the action, after the second pass.
#[derive(Debug, Clone, Default)]
struct Deviations {
    square: f64,
    xy: f64,
    xx: f64,
    yy: f64,
}

impl Deviations {
    fn add(&mut self, sums: &Sums, n: f64, value: f32, past: Option<f32>) {
        self.square += (f64::from(value) - sums.sum / n).powi(2);
        if let Some(past) = past {
            let pairs = sums.pairs as f64;
            let dx = f64::from(past) - sums.sum_past / pairs;
            let dy = f64::from(value) - sums.sum_present / pairs;
            self.xy += dx * dy;
            self.xx += dx * dx;
            self.yy += dy * dy;
        }
    }
}

/// Rows whose observation came before, and those of them with another action than the first.
#[derive(Debug, Default)]
struct Repeats {
    /// Hash of an observation, and of the action that came with it first.
    first: HashMap<u128, u64>,
    repeated: usize,
    conflicting: usize,
}

impl Repeats {
    fn add(&mut self, observation: ArrayView1<'_, f32>, action: &[f32]) {
        let hash = |salt: u64, values: &mut dyn Iterator<Item = f32>| {
            let mut hasher = DefaultHasher::new();
            salt.hash(&mut hasher);
            // Both zeros are one number.
            values.for_each(|value| (value + 0.0).to_bits().hash(&mut hasher));
            hasher.finish()
        };
        let half = |salt| u128::from(hash(salt, &mut observation.iter().copied()));
        let action = hash(0, &mut action.iter().copied());
        match self.first.entry((half(1) << 64) | half(2)) {
            std::collections::hash_map::Entry::Vacant(entry) => {
                entry.insert(action);
            }
            std::collections::hash_map::Entry::Occupied(entry) => {
                self.repeated += 1;
                self.conflicting += usize::from(*entry.get() != action);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::ops::Range;
    use std::path::Path;

    use ndarray::{Array1, Array2, array};

    use super::*;
    use crate::demonstrations::{Arrays, Demonstrations};

    fn demonstrations(actions: Array2<f32>, observations: Array2<f32>) -> Demonstrations {
        let n = actions.nrows();
        let flag = |at: usize| Array1::from_shape_fn(n, |row| row == at);
        let rewards = Array1::from_shape_fn(n, |row| row as f32);
        let (terminals, timeouts) = (flag(2), flag(n - 1));
        let arrays = Arrays { observations, actions, rewards, terminals, timeouts };
        Demonstrations::new(Path::new("here"), None, arrays).unwrap()
    }

    #[test]
    fn numbers_are_those_that_a_person_counts() {
        let actions = array![[0.0, 1.0], [0.5, 1.0], [1.0, -1.0], [0.2, 0.1], [0.2, 0.9995]];
        let observations = array![[1.0], [2.0], [0.0], [-0.0], [1.0]];
        let got = Statistics::of(&demonstrations(actions, observations)).unwrap();
        assert_eq!((got.returns, got.lengths), (vec![3.0, 7.0], vec![3, 2]));
        assert_eq!((got.terminated, got.timed_out), (1, 1));
        // Rows 3 and 4 repeat rows 2 and 0; both act otherwise.
        assert_eq!((got.repeated_observations, got.conflicting_actions), (2, 2));
        let [first, second] = &got.actions[..] else { panic!() };
        assert_eq!((first.at_bound, second.at_bound), (1, 3));
        assert!((second.saturated - 0.8).abs() < 1e-12);
        // Pairs within episodes only: (0, .5), (.5, 1), (.2, .2).
        let want = {
            let (x, y) = ([0.0, 0.5, 0.2], [0.5, 1.0, 0.2]);
            let mean = |v: [f64; 3]| v.iter().sum::<f64>() / 3.0;
            let (mx, my) = (mean(x), mean(y));
            let sum = |f: &dyn Fn(usize) -> f64| (0..3).map(f).sum::<f64>();
            sum(&|i| (x[i] - mx) * (y[i] - my))
                / (sum(&|i| (x[i] - mx).powi(2)) * sum(&|i| (y[i] - my).powi(2))).sqrt()
        };
        assert!((first.lag_1_correlation.unwrap() - want).abs() < 1e-6);
        let spread = Spread::of(&[1.0, 3.0]);
        assert_eq!(spread, Spread { mean: 2.0, std: 1.0, min: 1.0, max: 3.0 });
    }

    /// The same rows, a few at a time.
    struct InPieces(Demonstrations, usize);

    impl Recording for InPieces {
        fn outline(&self) -> &Outline {
            self.0.outline()
        }

        fn rows(&self, rows: Range<usize>) -> Result<Rows<'_>, DataError> {
            self.0.rows(rows)
        }

        fn for_each_block(
            &self,
            visit: &mut dyn FnMut(usize, &Rows<'_>) -> Result<(), DataError>,
        ) -> Result<(), DataError> {
            let transitions = self.outline().transitions();
            for start in (0..transitions).step_by(self.1) {
                visit(start, &self.rows(start..transitions.min(start + self.1))?)?;
            }
            Ok(())
        }
    }

    #[test]
    fn it_does_not_matter_where_blocks_end() {
        let entry = |(row, column): (usize, usize)| ((7 * row + 3 * column) % 11) as f32 / 10.0;
        let recording = || {
            demonstrations(
                Array2::from_shape_fn((17, 2), entry),
                Array2::from_shape_fn((17, 3), entry),
            )
        };
        let whole = Statistics::of(&recording()).unwrap();
        assert!(whole.repeated_observations > 0);
        for size in 1..=17 {
            let pieces = InPieces(recording(), size);
            assert_eq!(Statistics::of(&pieces).unwrap(), whole);
            let chosen = |recording: &dyn Recording| evenly_spaced_actions(recording, 5).unwrap();
            assert_eq!(chosen(&pieces), chosen(&recording()));
            assert_eq!(chosen(&pieces)[4], [entry((13, 0)), entry((13, 1))]);
        }
    }

    #[test]
    fn what_never_varies_has_no_correlation() {
        let same = demonstrations(Array2::from_elem((5, 1), 0.5), Array2::zeros((5, 1)));
        let got = Statistics::of(&same).unwrap();
        assert_eq!(got.actions[0].lag_1_correlation, None);
        assert_eq!((got.repeated_observations, got.conflicting_actions), (4, 0));
    }
}
