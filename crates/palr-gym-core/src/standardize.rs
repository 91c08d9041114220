//! Columns of zero mean and unit variance.

/// Why rows cannot be standardised.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum StandardizeError {
    /// No rows to take the mean of, or rows without columns.
    #[error("{values} values in rows of {width} columns; statistics need at least one row of one")]
    Empty {
        /// Values found.
        values: usize,
        /// Columns expected.
        width: usize,
    },
    /// The values are not whole rows.
    #[error("{values} values are not whole rows of {width} columns")]
    Width {
        /// Values found.
        values: usize,
        /// Columns expected.
        width: usize,
    },
    /// Rows of another number of columns than the statistics.
    #[error("{got} columns; the statistics are of {want}")]
    Columns {
        /// Columns found.
        got: usize,
        /// Columns of the statistics.
        want: usize,
    },
    /// NaN or infinity among the values, or values too large for a variance.
    #[error("column {column} has no finite mean and variance")]
    NotFinite {
        /// Column, from 0.
        column: usize,
    },
}

/// Mean and standard deviation of each column, and `(x - mean) / std` with them.
///
/// A column of one single value, so with zero variance, is only centred, that is, divided by 1; the
/// public reference code divides by zero there.
///
/// # Source
/// PALR's public code: population variance (ddof 0), no epsilon, statistics over the training rows'
/// zero-padded stacks. Differs from it in: sums in f64, and the columns of one single value.
///
/// ```
/// use palr_gym_core::Standardizer;
/// let mut rows = [1.0_f32, 7.0, 3.0, 7.0]; // [2, 2], the second column constant
/// let standardizer = Standardizer::fit(&rows, 2)?;
/// standardizer.standardize(&mut rows)?;
/// assert_eq!(rows, [-1.0, 0.0, 1.0, 0.0]);
/// # Ok::<(), palr_gym_core::StandardizeError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Standardizer {
    mean: Vec<f64>,
    std: Vec<f64>,
}

impl Standardizer {
    /// Statistics of `values`, `[n, width]` row-major with n ≥ 1.
    ///
    /// # Errors
    /// [`StandardizeError::Empty`], [`StandardizeError::Width`] or [`StandardizeError::NotFinite`].
    pub fn fit<T: Copy + Into<f64>>(values: &[T], width: usize) -> Result<Self, StandardizeError> {
        if width == 0 {
            return Err(StandardizeError::Empty { values: values.len(), width });
        }
        let mut means = Means::new(width)?;
        means.add(values)?;
        let mut deviations = means.finish()?;
        deviations.add(values);
        deviations.finish()
    }

    /// Columns.
    #[must_use]
    pub fn width(&self) -> usize {
        self.mean.len()
    }

    /// `[width]`.
    #[must_use]
    pub fn mean(&self) -> &[f64] {
        &self.mean
    }

    /// `[width]`, each > 0: 1 for a column of one single value.
    #[must_use]
    pub fn std(&self) -> &[f64] {
        &self.std
    }

    /// Replaces each x of `values`, `[n, width]` row-major, by `(x - mean) / std`, computed in f64.
    ///
    /// # Errors
    /// [`StandardizeError::Width`], and nothing is changed.
    pub fn standardize(&self, values: &mut [f32]) -> Result<(), StandardizeError> {
        self.replace(values, |value, mean, std| (value - mean) / std)
    }

    /// Undoes [`standardize`](Self::standardize): x becomes `x * std + mean`.
    ///
    /// # Errors
    /// [`StandardizeError::Width`], and nothing is changed.
    pub fn unstandardize(&self, values: &mut [f32]) -> Result<(), StandardizeError> {
        self.replace(values, |value, mean, std| value * std + mean)
    }

    fn replace(
        &self,
        values: &mut [f32],
        map: impl Fn(f64, f64, f64) -> f64,
    ) -> Result<(), StandardizeError> {
        check_width(values.len(), self.width())?;
        for row in values.chunks_exact_mut(self.width()) {
            for ((value, &mean), &std) in row.iter_mut().zip(&self.mean).zip(&self.std) {
                *value = map(f64::from(*value), mean, std) as f32;
            }
        }
        Ok(())
    }
}

/// The first of two passes over rows that are not in memory together. The statistics are those of
/// [`Standardizer::fit`], bit for bit, wherever the rows are cut into blocks.
#[derive(Debug, Clone)]
pub struct Means {
    values: usize,
    sums: Vec<f64>,
    bounds: Vec<(f64, f64)>,
}

impl Means {
    /// Of rows of `width` columns.
    ///
    /// # Errors
    /// [`StandardizeError::Empty`] without columns.
    pub fn new(width: usize) -> Result<Self, StandardizeError> {
        if width == 0 {
            return Err(StandardizeError::Empty { values: 0, width });
        }
        let bounds = vec![(f64::INFINITY, f64::NEG_INFINITY); width];
        Ok(Self { values: 0, sums: vec![0.0; width], bounds })
    }

    /// The next rows.
    ///
    /// # Errors
    /// [`StandardizeError::Width`] if they are no whole rows.
    pub fn add<T: Copy + Into<f64>>(&mut self, block: &[T]) -> Result<(), StandardizeError> {
        let width = self.sums.len();
        check_width(block.len(), width)?;
        self.values += block.len();
        for row in block.chunks_exact(width) {
            for ((sum, (low, high)), &value) in self.sums.iter_mut().zip(&mut self.bounds).zip(row)
            {
                let value = value.into();
                *sum += value;
                (*low, *high) = (low.min(value), high.max(value));
            }
        }
        Ok(())
    }

    /// Begins the second pass.
    ///
    /// # Errors
    /// [`StandardizeError::Empty`] without rows.
    pub fn finish(self) -> Result<Deviations, StandardizeError> {
        let Self { values, sums: mut mean, bounds } = self;
        let width = mean.len();
        if values == 0 {
            return Err(StandardizeError::Empty { values, width });
        }
        let n = (values / width) as f64;
        for (mean, &(low, high)) in mean.iter_mut().zip(&bounds) {
            // A sum of equal values need not divide back to that value.
            *mean = if low == high { low } else { *mean / n };
        }
        Ok(Deviations { n, squares: vec![0.0; width], mean })
    }
}

/// The second pass, over the same rows.
#[derive(Debug, Clone)]
pub struct Deviations {
    n: f64,
    mean: Vec<f64>,
    squares: Vec<f64>,
}

impl Deviations {
    /// The next rows.
    pub fn add<T: Copy + Into<f64>>(&mut self, block: &[T]) {
        for row in block.chunks_exact(self.mean.len()) {
            for ((sum, mean), &value) in self.squares.iter_mut().zip(&self.mean).zip(row) {
                *sum += (value.into() - mean).powi(2);
            }
        }
    }

    /// The statistics.
    ///
    /// # Errors
    /// [`StandardizeError::NotFinite`].
    pub fn finish(self) -> Result<Standardizer, StandardizeError> {
        let Self { n, mean, squares: mut std } = self;
        for (column, (std, mean)) in std.iter_mut().zip(&mean).enumerate() {
            *std = (*std / n).sqrt();
            if !(std.is_finite() && mean.is_finite()) {
                return Err(StandardizeError::NotFinite { column });
            }
            if *std == 0.0 {
                *std = 1.0;
            }
        }
        Ok(Standardizer { mean, std })
    }
}

fn check_width(values: usize, width: usize) -> Result<(), StandardizeError> {
    if values.is_multiple_of(width) {
        Ok(())
    } else {
        Err(StandardizeError::Width { values, width })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Rows of 1 to 4 columns, whose scales and offsets differ by orders of magnitude.
    fn rows() -> impl Strategy<Value = (usize, Vec<f32>)> {
        (1..5usize, 1..30usize).prop_flat_map(|(width, n)| {
            let scales = prop::collection::vec((-1e3..1e3_f32, 1e-2..1e2_f32), width);
            let noise = prop::collection::vec(-1.0..1.0_f32, n * width);
            (Just(width), scales, noise).prop_map(|(width, scales, noise)| {
                let values = noise.iter().enumerate().map(|(i, noise)| {
                    let (offset, scale) = scales[i % width];
                    offset + scale * noise
                });
                (width, values.collect())
            })
        })
    }

    fn column(values: &[f32], width: usize, column: usize) -> Vec<f64> {
        values.iter().skip(column).step_by(width).map(|&value| f64::from(value)).collect()
    }

    #[test]
    fn rows_in_blocks_have_the_statistics_of_all_together() {
        let values: Vec<f32> = (0..30).map(|at| (at * at % 17) as f32 / 7.0).collect();
        let whole = Standardizer::fit(&values, 3).unwrap();
        for rows in 1..=10 {
            let mut means = Means::new(3).unwrap();
            values.chunks(3 * rows).for_each(|block| means.add(block).unwrap());
            let mut deviations = means.finish().unwrap();
            values.chunks(3 * rows).for_each(|block| deviations.add(block));
            assert_eq!(deviations.finish().unwrap(), whole);
        }
        assert_eq!(
            Means::new(3).unwrap().add(&[1.0_f32]),
            Standardizer::fit(&[1.0_f32], 3).map(|_| ())
        );
        assert!(Means::new(3).unwrap().finish().is_err());
    }

    proptest! {
        #[test]
        fn statistics_are_those_of_the_textbook((width, values) in rows()) {
            let standardizer = Standardizer::fit(&values, width).unwrap();
            for j in 0..width {
                let x = column(&values, width, j);
                let n = x.len() as f64;
                let mean = x.iter().sum::<f64>() / n;
                let variance = x.iter().map(|x| x * x).sum::<f64>() / n - mean * mean;
                prop_assert!((standardizer.mean()[j] - mean).abs() <= 1e-9);
                let got = standardizer.std()[j];
                if x.iter().all(|&other| other == x[0]) {
                    prop_assert_eq!(got, 1.0);
                } else {
                    prop_assert!((got * got - variance).abs() <= 1e-7, "{got} {variance}");
                }
            }
        }

        #[test]
        fn standardized_columns_have_zero_mean_and_unit_variance((width, values) in rows()) {
            let mut standardized = values.clone();
            let standardizer = Standardizer::fit(&values, width).unwrap();
            standardizer.standardize(&mut standardized).unwrap();
            for j in 0..width {
                let (before, z) = (column(&values, width, j), column(&standardized, width, j));
                let n = z.len() as f64;
                prop_assert!(z.iter().sum::<f64>().abs() / n < 1e-6);
                let expected = f64::from(before.iter().any(|&other| other != before[0]));
                let variance = z.iter().map(|z| z * z).sum::<f64>() / n;
                prop_assert!((variance - expected).abs() < 1e-5, "{variance}");
                for (x, z) in before.iter().zip(&z) {
                    let direct = (x - standardizer.mean()[j]) / standardizer.std()[j];
                    prop_assert_eq!(*z, f64::from(direct as f32));
                }
            }
        }

        #[test]
        fn unstandardize_undoes_standardize((width, values) in rows()) {
            let standardizer = Standardizer::fit(&values, width).unwrap();
            let mut back = values.clone();
            standardizer.standardize(&mut back).unwrap();
            standardizer.unstandardize(&mut back).unwrap();
            for (i, (x, back)) in values.iter().zip(&back).enumerate() {
                let mean = standardizer.mean()[i % width];
                // One rounding to f32 on each way.
                let roundings = f64::from(x.abs()) + (f64::from(*x) - mean).abs();
                let allowed = f64::from(f32::EPSILON) * roundings;
                prop_assert!(f64::from((x - back).abs()) <= allowed, "{x} {back}");
            }
        }

        /// 0.1 added up n times and divided by n is not 0.1 in f64 for most n.
        #[test]
        fn a_column_of_one_single_value_is_exactly_centred(value in -1e6..1e6_f64, n in 1..300usize) {
            let standardizer = Standardizer::fit(&vec![value; n], 1).unwrap();
            prop_assert_eq!((standardizer.mean()[0], standardizer.std()[0]), (value, 1.0));
        }
    }

    #[test]
    fn differences_too_small_to_square_do_not_divide_by_zero() {
        let standardizer = Standardizer::fit(&[0.0, 1e-300], 1).unwrap();
        assert_eq!(standardizer.std(), [1.0]);
    }

    #[test]
    fn what_has_no_statistics_is_refused() {
        fn check(values: &[f64], width: usize, expected: &str) {
            let error = Standardizer::fit(values, width).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
        check(&[], 3, "0 values in rows of 3 columns");
        check(&[1.0], 0, "1 values in rows of 0 columns");
        check(&[1.0, 2.0, 3.0], 2, "3 values are not whole rows of 2 columns");
        check(&[1.0, f64::NAN, 3.0, 1.0], 2, "column 1 has no finite mean");
        check(&[f64::INFINITY, 1.0], 2, "column 0 has no finite mean");
        check(&[f64::NAN, f64::NAN], 1, "column 0 has no finite mean");
        check(&[1e200, -1e200], 1, "column 0 has no finite mean");
        let mut values = [1.0; 3];
        let error = Standardizer::fit(&[1.0_f32, 2.0], 2).unwrap().standardize(&mut values);
        assert_eq!(error, Err(StandardizeError::Width { values: 3, width: 2 }));
        assert_eq!(values, [1.0; 3]);
    }
}
