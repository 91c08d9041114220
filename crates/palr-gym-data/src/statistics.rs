//! What a data set is like, in numbers that decide whether methods can be told apart on it.

use std::collections::HashMap;

use ndarray::ArrayView1;

use crate::demonstrations::Demonstrations;

/// Actions at least this large count as saturated: tanh of them is past 3.8.
pub const SATURATED: f32 = 0.999;

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
#[derive(Debug, Clone, Copy, PartialEq)]
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
    /// Of `demonstrations`.
    #[must_use]
    pub fn of(demonstrations: &Demonstrations) -> Self {
        let rewards = demonstrations.rewards();
        let episodes = demonstrations.episodes();
        let sum = |episode: &std::ops::Range<usize>| {
            rewards.slice(ndarray::s![episode.clone()]).iter().map(|&r| f64::from(r)).sum()
        };
        let is_last = |flags: &ndarray::Array1<bool>| {
            episodes.iter().filter(|episode| flags[episode.end - 1]).count()
        };
        let (repeated_observations, conflicting_actions) = repeats(demonstrations);
        Self {
            returns: episodes.iter().map(sum).collect(),
            lengths: episodes.iter().map(ExactSizeIterator::len).collect(),
            terminated: is_last(demonstrations.terminals()),
            timed_out: is_last(demonstrations.timeouts()),
            actions: demonstrations
                .actions()
                .columns()
                .into_iter()
                .map(|column| action(column, episodes))
                .collect(),
            repeated_observations,
            conflicting_actions,
        }
    }
}

fn action(column: ArrayView1<'_, f32>, episodes: &[std::ops::Range<usize>]) -> ActionStatistics {
    let values: Vec<f64> = column.iter().map(|&value| f64::from(value)).collect();
    let saturated = column.iter().filter(|value| value.abs() >= SATURATED).count();
    let pairs = episodes.iter().flat_map(|episode| {
        (episode.start + 1..episode.end).map(|row| (values[row - 1], values[row]))
    });
    ActionStatistics {
        spread: Spread::of(&values),
        saturated: saturated as f64 / values.len() as f64,
        at_bound: column.iter().filter(|value| value.abs() == 1.0).count(),
        lag_1_correlation: correlation(&pairs.collect::<Vec<_>>()),
    }
}

/// Pearson's.
fn correlation(pairs: &[(f64, f64)]) -> Option<f64> {
    let n = pairs.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| pairs.iter().map(of).sum::<f64>() / n;
    let (x, y) = (mean(|pair| pair.0), mean(|pair| pair.1));
    let (mut xy, mut xx, mut yy) = (0.0, 0.0, 0.0);
    for pair in pairs {
        let (dx, dy) = (pair.0 - x, pair.1 - y);
        xy += dx * dy;
        xx += dx * dx;
        yy += dy * dy;
    }
    let scale = (xx * yy).sqrt();
    (scale > 0.0).then(|| xy / scale)
}

/// Rows whose observation came before, and those of them with another action.
fn repeats(demonstrations: &Demonstrations) -> (usize, usize) {
    let bits = |row: ArrayView1<'_, f32>| -> Vec<u32> {
        // Both zeros are one observation.
        row.iter().map(|value| (value + 0.0).to_bits()).collect()
    };
    let actions = demonstrations.actions();
    let mut first = HashMap::new();
    let (mut repeated, mut conflicting) = (0, 0);
    for (row, observation) in demonstrations.observations().rows().into_iter().enumerate() {
        let earlier = *first.entry(bits(observation)).or_insert(row);
        if earlier != row {
            repeated += 1;
            conflicting += usize::from(actions.row(earlier) != actions.row(row));
        }
    }
    (repeated, conflicting)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use ndarray::{Array1, Array2, array};

    use super::*;
    use crate::demonstrations::Arrays;

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
        let got = Statistics::of(&demonstrations(actions, observations));
        assert_eq!((got.returns, got.lengths), (vec![3.0, 7.0], vec![3, 2]));
        assert_eq!((got.terminated, got.timed_out), (1, 1));
        // Rows 3 and 4 repeat rows 2 and 0; both act otherwise.
        assert_eq!((got.repeated_observations, got.conflicting_actions), (2, 2));
        let [first, second] = got.actions[..] else { panic!() };
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

    #[test]
    fn what_never_varies_has_no_correlation() {
        let same = demonstrations(Array2::from_elem((5, 1), 0.5), Array2::zeros((5, 1)));
        let got = Statistics::of(&same);
        assert_eq!(got.actions[0].lag_1_correlation, None);
        assert_eq!((got.repeated_observations, got.conflicting_actions), (4, 0));
    }
}
