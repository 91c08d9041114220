//! Expert data as training wants it: standardised, and with what the likelihood needs of each
//! action computed once.

use palr_gym_core::standardize::Means;

use crate::learning::error::TrainError;

/// Expert actions are clamped to ± this before atanh (the reference implementation's constant).
const LARGEST_ACTION: f32 = 0.999_999;

/// Mean and standard deviation of each column.
///
/// A column without variance has deviation 1: it becomes 0 everywhere, and nothing is divided by 0.
#[derive(Debug, Clone, PartialEq)]
pub struct Standardization {
    /// `[d]`.
    pub mean: Vec<f32>,
    /// `[d]`, each > 0; divided by n, not n - 1.
    pub std: Vec<f32>,
}

impl Standardization {
    /// The statistics of `values`, `[n, d]`, rounded to the policy's precision.
    ///
    /// # Errors
    /// [`TrainError::Standardize`] without rows, or with numbers that are not finite.
    pub fn of(values: &[f32], d: usize) -> Result<Self, TrainError> {
        Self::of_blocks(d, |visit| {
            visit(values);
            Ok(())
        })
    }

    /// As [`of`](Self::of), of rows that `for_each_block` shows block by block, twice.
    ///
    /// # Errors
    /// As [`of`](Self::of), and those of `for_each_block`.
    pub fn of_blocks<E: From<TrainError>>(
        d: usize,
        mut for_each_block: impl FnMut(&mut dyn FnMut(&[f32])) -> Result<(), E>,
    ) -> Result<Self, E> {
        let mut means = Means::new(d).map_err(TrainError::from)?;
        let mut misfit = Ok(());
        for_each_block(&mut |block| {
            if misfit.is_ok() {
                misfit = means.add(block);
            }
        })?;
        misfit.map_err(TrainError::from)?;
        let mut deviations = means.finish().map_err(TrainError::from)?;
        for_each_block(&mut |block| deviations.add(block))?;
        let fitted = deviations.finish().map_err(TrainError::from)?;
        let narrow = |values: &[f64]| values.iter().map(|&value| value as f32).collect::<Vec<_>>();
        let mut std = narrow(fitted.std());
        // A deviation too small for f32 is none.
        std.iter_mut().filter(|std| **std == 0.0).for_each(|std| *std = 1.0);
        Ok(Self { mean: narrow(fitted.mean()), std })
    }

    /// `(values - mean) / std`, column by column; `[n, d]` -> `[n, d]`.
    #[must_use]
    pub fn apply(&self, values: &[f32]) -> Vec<f32> {
        let d = self.mean.len();
        let columns = self.mean.iter().zip(&self.std).cycle().take(values.len() / d * d);
        values.iter().zip(columns).map(|(value, (mean, std))| (value - mean) / std).collect()
    }
}

/// Expert transitions.
///
/// # Invariants
/// All arrays have `len()` rows, are row-major and finite.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainingSet {
    n: usize,
    observation_size: usize,
    action_size: usize,
    /// w: an observation is so many equal frames, oldest first.
    frame_stack: usize,
    /// `[n]`: rows of the same episode right before each row; none if nobody said.
    rows_before: Option<Vec<u32>>,
    observation_statistics: Standardization,
    /// `[n, observation_size]`, standardised.
    observations: Vec<f32>,
    /// `[n, action_size]`, raw.
    actions: Vec<f32>,
    /// `[n, action_size]`, raw; zeros at the start of an episode.
    past_actions: Vec<f32>,
    /// `[n, action_size]`: atanh of the clamped actions.
    pre_tanh: Vec<f32>,
    /// `[n]`: what the parameters do not change of the negative log-likelihood, in nats.
    nll_offsets: Vec<f64>,
    action_statistics: Standardization,
    past_action_statistics: Standardization,
}

/// Rows of a [`TrainingSet`], row-major.
#[derive(Debug, Clone, Copy)]
pub struct RowArrays<'a> {
    /// `[n, observation_size]`, standardised.
    pub observations: &'a [f32],
    /// `[n, action_size]`.
    pub actions: &'a [f32],
    /// `[n, action_size]`.
    pub past_actions: &'a [f32],
}

impl TrainingSet {
    /// Takes raw stacked observations `[n, observation_size]`, actions and past actions
    /// `[n, action_size]`. Statistics are those of these rows.
    ///
    /// # Errors
    /// [`TrainError::Length`] or [`TrainError::NotFinite`].
    pub fn new(
        observations: &[f32],
        observation_size: usize,
        actions: Vec<f32>,
        past_actions: Vec<f32>,
        action_size: usize,
    ) -> Result<Self, TrainError> {
        check("observations", observations, observation_size, None)?;
        let statistics = Standardization::of(observations, observation_size)?;
        Self::with_statistics(observations, statistics, actions, past_actions, action_size)
    }

    /// Other rows of the same task, such as held-out ones, standardised by the statistics of
    /// `self`.
    ///
    /// # Errors
    /// [`TrainError::Length`] or [`TrainError::NotFinite`].
    pub fn like(
        &self,
        observations: &[f32],
        actions: Vec<f32>,
        past_actions: Vec<f32>,
    ) -> Result<Self, TrainError> {
        let statistics = self.observation_statistics.clone();
        let mut set = Self::with_statistics(
            observations,
            statistics,
            actions,
            past_actions,
            self.action_size,
        )?;
        set.action_statistics = self.action_statistics.clone();
        set.past_action_statistics = self.past_action_statistics.clone();
        set.frame_stack = self.frame_stack;
        Ok(set)
    }

    /// Says that an observation is `frame_stack` equal frames, oldest first; without it, it is one.
    /// Methods that treat the last frame by itself need it.
    ///
    /// # Errors
    /// [`TrainError::Size`] if an observation cannot be split so.
    pub fn with_frame_stack(mut self, frame_stack: usize) -> Result<Self, TrainError> {
        if frame_stack == 0 || !self.observation_size.is_multiple_of(frame_stack) {
            let what = "the frame stack of an observation";
            return Err(TrainError::Size { what, got: frame_stack, want: self.observation_size });
        }
        self.frame_stack = frame_stack;
        Ok(self)
    }

    /// Says how many consecutive rows each episode gave, in order. Methods that look back further
    /// than one action need it.
    ///
    /// # Errors
    /// [`TrainError::Size`] if they do not sum to the number of rows.
    pub fn with_episodes(mut self, lengths: &[usize]) -> Result<Self, TrainError> {
        let got = lengths.iter().sum();
        if got != self.n {
            let what = "the rows of all episodes";
            return Err(TrainError::Size { what, got, want: self.n });
        }
        let rows = lengths.iter().flat_map(|&length| 0..length as u32);
        self.rows_before = Some(rows.collect());
        Ok(self)
    }

    /// As [`Self::new`], with statistics of other rows, such as those of a whole data set (the
    /// paper's text; the reference code takes the training rows').
    ///
    /// # Errors
    /// [`TrainError::Length`] or [`TrainError::NotFinite`].
    pub fn with_statistics(
        observations: &[f32],
        observation_statistics: Standardization,
        actions: Vec<f32>,
        past_actions: Vec<f32>,
        action_size: usize,
    ) -> Result<Self, TrainError> {
        let observation_size = observation_statistics.mean.len();
        check("statistics.mean", &observation_statistics.mean, observation_size, Some(1))?;
        check("statistics.std", &observation_statistics.std, observation_size, Some(1))?;
        let n = check("observations", observations, observation_size, None)?;
        check("actions", &actions, action_size, Some(n))?;
        check("past_actions", &past_actions, action_size, Some(n))?;
        let pre_tanh: Vec<f32> = actions
            .iter()
            .map(|action| f64::from(action.clamp(-LARGEST_ACTION, LARGEST_ACTION)).atanh() as f32)
            .collect();
        let nll_offsets = pre_tanh.chunks_exact(action_size).map(nll_offset).collect();
        Ok(Self {
            n,
            observation_size,
            action_size,
            frame_stack: 1,
            rows_before: None,
            observations: observation_statistics.apply(observations),
            observation_statistics,
            action_statistics: Standardization::of(&actions, action_size)?,
            past_action_statistics: Standardization::of(&past_actions, action_size)?,
            actions,
            past_actions,
            pre_tanh,
            nll_offsets,
        })
    }

    /// Refuses a column of actions that has one value only: no likelihood is the best there.
    ///
    /// # Errors
    /// [`TrainError::Constant`].
    pub fn check_actions_vary(&self) -> Result<(), TrainError> {
        for column in 0..self.action_size {
            let mut values = self.actions.iter().skip(column).step_by(self.action_size);
            let Some(&value) = values.next() else { continue };
            if values.all(|other| *other == value) {
                return Err(TrainError::Constant { name: "actions", column, value, rows: self.n });
            }
        }
        Ok(())
    }

    /// Number of rows.
    #[must_use]
    pub fn len(&self) -> usize {
        self.n
    }

    /// False: a set has at least one row.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.n == 0
    }

    /// D, of a stacked observation.
    #[must_use]
    pub fn observation_size(&self) -> usize {
        self.observation_size
    }

    /// A.
    #[must_use]
    pub fn action_size(&self) -> usize {
        self.action_size
    }

    /// Width of a frame.
    #[must_use]
    pub fn frame_size(&self) -> usize {
        self.observation_size / self.frame_stack
    }

    /// By which the observations were standardised.
    #[must_use]
    pub fn observation_statistics(&self) -> &Standardization {
        &self.observation_statistics
    }

    /// All rows.
    #[must_use]
    pub fn arrays(&self) -> RowArrays<'_> {
        let Self { observations, actions, past_actions, .. } = self;
        RowArrays { observations, actions, past_actions }
    }

    /// The given rows, standardised.
    #[must_use]
    pub fn batch(&self, rows: &[usize]) -> Batch {
        Batch {
            n: rows.len(),
            observations: gather(&self.observations, self.observation_size, rows),
            actions: gather(&self.actions, self.action_size, rows),
            past_actions: gather(&self.past_actions, self.action_size, rows),
            pre_tanh: gather(&self.pre_tanh, self.action_size, rows),
            nll_offset: rows.iter().map(|&row| self.nll_offsets[row]).sum::<f64>()
                / rows.len() as f64,
        }
    }

    /// Past and given actions of the rows, `[n, action_size]` each, as HSCIC conditions on them.
    #[must_use]
    pub fn hscic_actions(&self, rows: &[usize], is_standardized: bool) -> (Vec<f32>, Vec<f32>) {
        let past = gather(&self.past_actions, self.action_size, rows);
        let given = gather(&self.actions, self.action_size, rows);
        if is_standardized {
            (self.past_action_statistics.apply(&past), self.action_statistics.apply(&given))
        } else {
            (past, given)
        }
    }

    /// The last `count` actions before each row's, newest first, zeros where the episode or the
    /// set begins: `[n, count · action_size]`.
    ///
    /// # Errors
    /// [`TrainError::Setting`] if `count` is above 1 and nobody said where episodes begin.
    pub fn action_history(&self, rows: &[usize], count: usize) -> Result<Vec<f32>, TrainError> {
        if count == 1 {
            return Ok(gather(&self.past_actions, self.action_size, rows));
        }
        let Some(rows_before) = &self.rows_before else {
            let message = format!(
                "{count} past actions are asked for; the data do not say where \
                episodes begin, so expected 1"
            );
            return Err(TrainError::Setting { message });
        };
        let size = self.action_size;
        let mut history = vec![0.0; rows.len() * count * size];
        for (slots, &row) in history.chunks_exact_mut(count * size).zip(rows) {
            let known = count.min(rows_before[row] as usize + 1);
            for (back, slot) in slots.chunks_exact_mut(size).take(known).enumerate() {
                let row = row - back;
                slot.copy_from_slice(&self.past_actions[row * size..(row + 1) * size]);
            }
        }
        Ok(history)
    }

    /// A checksum of the actions: M follows from them and the drawn rows.
    #[must_use]
    pub(crate) fn actions_fingerprint(&self) -> u32 {
        let mut hasher = crc32fast::Hasher::new();
        for array in [&self.actions, &self.past_actions] {
            hasher.update(bytemuck::cast_slice(array));
        }
        hasher.finalize()
    }

    /// A checksum of everything that a run reads of the set.
    #[must_use]
    pub fn fingerprint(&self) -> u32 {
        let mut hasher = crc32fast::Hasher::new();
        for size in [self.n, self.observation_size, self.action_size, self.frame_stack] {
            hasher.update(&(size as u64).to_le_bytes());
        }
        if let Some(rows_before) = &self.rows_before {
            hasher.update(bytemuck::cast_slice(rows_before));
        }
        for array in [&self.observations, &self.actions, &self.past_actions] {
            hasher.update(bytemuck::cast_slice(array));
        }
        hasher.finalize()
    }
}

/// The rows of a step.
#[derive(Debug, Clone, PartialEq)]
pub struct Batch {
    /// Number of rows.
    pub n: usize,
    /// `[n, observation_size]`, standardised.
    pub observations: Vec<f32>,
    /// `[n, action_size]`, raw.
    pub actions: Vec<f32>,
    /// `[n, action_size]`, raw.
    pub past_actions: Vec<f32>,
    /// `[n, action_size]`: atanh of the clamped actions.
    pub pre_tanh: Vec<f32>,
    /// Mean over the rows of what no parameter changes of the negative log-likelihood, in nats.
    pub nll_offset: f64,
}

/// Of one action with `u` before tanh: the normal's constant, and the logarithm of tanh's slope,
/// `2 (log 2 - u - softplus(-2u))`, which keeps its digits where tanh saturates.
pub(crate) fn nll_offset(u: &[f32]) -> f64 {
    let half_log_tau = 0.5 * std::f64::consts::TAU.ln();
    u.iter()
        .map(|&u| {
            let u = f64::from(u);
            let softplus = (-2.0 * u).max(0.0) + (-(2.0 * u).abs()).exp().ln_1p();
            half_log_tau + 2.0 * (std::f64::consts::LN_2 - u - softplus)
        })
        .sum()
}

fn gather(values: &[f32], d: usize, rows: &[usize]) -> Vec<f32> {
    let mut gathered = Vec::with_capacity(rows.len() * d);
    for &row in rows {
        gathered.extend_from_slice(&values[row * d..(row + 1) * d]);
    }
    gathered
}

/// Number of rows of `values`, `[n, d]`.
fn check(
    name: &'static str,
    values: &[f32],
    d: usize,
    rows: Option<usize>,
) -> Result<usize, TrainError> {
    let got = values.len();
    let is_right = match rows {
        Some(rows) => d > 0 && got == rows * d,
        None => d > 0 && got > 0 && got.is_multiple_of(d),
    };
    if !is_right {
        let want = match rows {
            Some(rows) => format!("{rows} rows of {d}, at least one in each"),
            None => format!("one or more rows of {d}"),
        };
        return Err(TrainError::Length { name, got, want });
    }
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(got / d),
        Some(position) => Err(TrainError::NotFinite {
            name,
            row: position / d,
            column: position % d,
            value: values[position],
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_have_mean_zero_and_deviation_one_and_constants_become_zero() {
        let raw: Vec<f32> = (0..50).flat_map(|i| [i as f32 * 3.0 - 7.0, 0.1, 1e6]).collect();
        let set = TrainingSet::new(&raw, 3, vec![0.0; 50], vec![0.0; 50], 1).unwrap();
        let batch = set.batch(&(0..50).collect::<Vec<_>>());
        let column = |c: usize| batch.observations.iter().skip(c).step_by(3).copied();
        let moment = |power| column(0).map(|x| f64::from(x).powi(power)).sum::<f64>() / 50.0;
        assert!(moment(1).abs() < 1e-6 && (moment(2) - 1.0).abs() < 1e-6);
        assert!(column(1).chain(column(2)).all(|value| value == 0.0));
        let (past, given) = set.hscic_actions(&[0, 1], true);
        assert!(past.iter().chain(&given).all(|&value| value == 0.0));
    }

    #[test]
    fn held_out_rows_are_standardised_by_the_training_rows() {
        let set = TrainingSet::new(&[0.0, 2.0], 1, vec![0.0, 0.5], vec![0.0; 2], 1).unwrap();
        let held_out = set.like(&[3.0], vec![0.5], vec![0.0]).unwrap();
        assert_eq!(held_out.batch(&[0]).observations, [2.0]);
        assert_eq!(held_out.hscic_actions(&[0], true).1, [1.0]);
        assert_eq!(held_out.hscic_actions(&[0], false).1, [0.5]);
        let statistics = Standardization { mean: vec![1.0], std: vec![4.0] };
        let actions = || (vec![0.5], vec![0.0]);
        let (action, past) = actions();
        let set = TrainingSet::with_statistics(&[3.0], statistics, action, past, 1).unwrap();
        assert_eq!(set.batch(&[0]).observations, [0.5]);
        let statistics = Standardization { mean: vec![1.0], std: vec![] };
        let (action, past) = actions();
        let error = TrainingSet::with_statistics(&[3.0], statistics, action, past, 1).unwrap_err();
        assert!(error.to_string().contains("statistics.std has 0 numbers; expected 1 rows of 1"));
    }

    #[test]
    fn histories_reach_back_to_the_start_of_the_episode() {
        let actions: Vec<f32> = (1..=5).map(|i| i as f32).collect();
        // Two episodes; the first one began before the set.
        let past = vec![9.0, 1.0, 2.0, 0.0, 4.0];
        let set = TrainingSet::new(&[0.0; 5], 1, actions, past, 1).unwrap();
        assert_eq!(set.action_history(&[2, 3], 1).unwrap(), [2.0, 0.0]);
        let error = set.action_history(&[2], 3).unwrap_err().to_string();
        assert!(error.contains("3 past actions are asked for"), "{error}");
        let error = set.clone().with_episodes(&[3, 1]).unwrap_err().to_string();
        assert_eq!(error, "the rows of all episodes has size 4; expected 5");
        let set = set.with_episodes(&[3, 2]).unwrap();
        let history = set.action_history(&[0, 2, 3, 4], 3).unwrap();
        assert_eq!(history, [9.0, 0.0, 0.0, 2.0, 1.0, 9.0, 0.0, 0.0, 0.0, 4.0, 0.0, 0.0]);
        assert!(set.clone().with_frame_stack(2).is_err() && set.with_frame_stack(1).is_ok());
    }

    #[test]
    fn actions_that_never_vary_are_refused() {
        let set = |actions| TrainingSet::new(&[0.0, 1.0], 1, actions, vec![0.0; 4], 2).unwrap();
        set(vec![0.1, 0.2, 0.3, 0.4]).check_actions_vary().unwrap();
        let error = set(vec![0.1, 0.2, 0.3, 0.2]).check_actions_vary().unwrap_err().to_string();
        assert_eq!(error, "column 1 of actions is 0.2 in all 2 rows; expected actions that vary");
    }

    #[test]
    fn wrong_arrays_are_refused_with_what_was_wanted() {
        let new = |observations: &[f32], actions| {
            TrainingSet::new(observations, 2, actions, vec![0.0; 2], 1).unwrap_err().to_string()
        };
        assert!(new(&[0.0; 3], vec![0.0; 2]).contains("observations has 3 numbers"));
        assert!(new(&[], vec![]).contains("expected one or more rows of 2"));
        assert!(new(&[0.0; 4], vec![0.0; 3]).contains("actions has 3 numbers; expected 2 rows"));
        let error = new(&[0.0, 0.0, 0.0, f32::NAN], vec![0.0; 2]);
        assert!(error.contains("observations is NaN in row 1, column 1"), "{error}");
    }
}
