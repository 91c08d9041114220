//! [`Standardizer`] on matrices.

use ndarray::{Array2, ArrayView2};
use palr_gym_core::{StandardizeError, Standardizer};

/// Statistics of the columns of `rows`, `[n, width]`.
///
/// For observations, `rows` are the training rows' zero-padded stacks, zeros included.
///
/// # Errors
/// [`StandardizeError`] without rows, or where values are not finite.
pub fn fit(rows: ArrayView2<'_, f32>) -> Result<Standardizer, StandardizeError> {
    let in_order = rows.as_standard_layout();
    Standardizer::fit(in_order.as_slice().unwrap_or_default(), rows.ncols())
}

/// `(x - mean) / std` of each entry of `rows`, `[n, width]`.
///
/// # Errors
/// [`StandardizeError::Columns`] if the statistics are of another number of columns.
pub fn standardized(
    standardizer: &Standardizer,
    rows: ArrayView2<'_, f32>,
) -> Result<Array2<f32>, StandardizeError> {
    let (got, want) = (rows.ncols(), standardizer.width());
    if got != want {
        return Err(StandardizeError::Columns { got, want });
    }
    let mut standardized = rows.as_standard_layout().into_owned();
    standardizer.standardize(standardized.as_slice_mut().unwrap_or_default())?;
    Ok(standardized)
}

#[cfg(test)]
mod tests {
    use ndarray::{arr2, s};

    use super::*;

    #[test]
    fn columns_are_columns_whatever_the_layout() {
        let rows = arr2(&[[1.0, 9.0, 3.0], [7.0, 9.0, 7.0]]);
        let expected = arr2(&[[-1.0, -1.0], [1.0, 1.0]]);
        let outer = rows.slice(s![.., ..;2]);
        let transposed = rows.t().to_owned();
        let transposed = transposed.slice(s![..;2, ..]);
        for view in [outer, transposed.t()] {
            let standardizer = fit(view).unwrap();
            assert_eq!(
                (standardizer.mean(), standardizer.std()),
                (&[4.0, 5.0][..], &[3.0, 2.0][..])
            );
            assert_eq!(standardized(&standardizer, view), Ok(expected.clone()));
        }
    }

    #[test]
    fn other_columns_are_refused() {
        let standardizer = fit(arr2(&[[1.0, 2.0]]).view()).unwrap();
        // As many values as two rows of two columns.
        let error = standardized(&standardizer, arr2(&[[1.0; 4]]).view()).unwrap_err();
        assert_eq!(error.to_string(), "4 columns; the statistics are of 2");
        assert!(fit(Array2::zeros((0, 2)).view()).is_err());
    }
}
