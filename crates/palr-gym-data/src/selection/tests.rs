#![allow(clippy::single_range_in_vec_init, reason = "a list of one range is what is meant")]

use std::path::Path;

use ndarray::{Array1, Array2};
use proptest::prelude::*;

use super::*;
use crate::demonstrations::{Arrays, Demonstrations};
use crate::recording::Recording;

/// Episodes of the given lengths, the last one without a flag.
fn demonstrations(lengths: &[usize]) -> Demonstrations {
    let n: usize = lengths.iter().sum();
    let mut timeouts = Array1::from_elem(n, false);
    let mut end = 0;
    for length in &lengths[..lengths.len() - 1] {
        end += length;
        timeouts[end - 1] = true;
    }
    let arrays = Arrays {
        observations: Array2::zeros((n, 1)),
        actions: Array2::zeros((n, 1)),
        rewards: Array1::zeros(n),
        terminals: Array1::from_elem(n, false),
        timeouts,
    };
    Demonstrations::new(Path::new("data.hdf5"), None, arrays).unwrap()
}

fn check(lengths: &[usize], selection: Selection, expected: Result<&[Range<usize>], &str>) {
    match (selection.row_ranges(demonstrations(lengths).outline()), expected) {
        (Ok(got), Ok(expected)) => assert_eq!(got, expected, "{selection:?}"),
        (Err(error), Err(expected)) => {
            assert!(error.to_string().contains(expected), "{selection:?}: {error}");
        }
        (got, expected) => panic!("{selection:?}: got {got:?}, expected {expected:?}"),
    }
}

#[test]
fn the_first_rows_are_cut_where_episodes_end() {
    check(&[3, 4], Selection::first(2), Ok(&[0..2]));
    check(&[3, 4], Selection::first(3), Ok(&[0..3]));
    check(&[3, 4], Selection::first(5), Ok(&[0..3, 3..5]));
    check(&[3, 4], Selection::first(7), Ok(&[0..3, 3..7]));
    check(&[3, 4], Selection::first(0), Err("a selection of 0 rows; expected at least 1"));
    check(
        &[3, 4],
        Selection::first(8),
        Err("data.hdf5: 8 rows from row 0 on were asked for; the file has 7"),
    );
}

#[test]
fn a_slice_is_consecutive_and_never_trained_on() {
    check(&[3, 4, 2], HeldOut::slice(4, 2).after(4), Ok(&[4..6]));
    check(&[3, 4, 2], HeldOut::slice(2, 6).after(0), Ok(&[2..3, 3..7, 7..8]));
    check(&[3, 4, 2], HeldOut::slice(4, 0).after(0), Err("a selection of 0 rows"));
    check(
        &[3, 4, 2],
        HeldOut::slice(4, 2).after(5),
        Err("held-out rows start at row 4, within the 5 training rows"),
    );
    let too_many = "rows from row 4 on were asked for; the file has 9";
    check(&[3, 4, 2], HeldOut::slice(4, 6).after(4), Err(too_many));
    check(&[3, 4, 2], HeldOut::slice(4, usize::MAX).after(4), Err(too_many));
}

/// Written out by hand from the definition.
#[test]
fn spread_rows_are_even_over_episodes_and_over_time() {
    // Episodes begin at 0, 10, ..., 50; the training cuts into the second one.
    let lengths = [10; 6];
    let spread = |rows, episodes| HeldOut::spread(rows, episodes).after(11);
    check(&lengths, spread(4, 4), Ok(&[20..21, 33..34, 46..47, 59..60]));
    check(&lengths, spread(8, 2), Ok(&[30..34, 56..60]));
    // Two episodes hold only 20 rows.
    check(&lengths, spread(21, 2), Ok(&[20..27, 41..48, 53..60]));
    check(&lengths, spread(40, 2), Ok(&[20..30, 30..40, 40..50, 50..60]));
    check(&lengths, spread(1, 1), Ok(&[40..41]));
    check(&lengths, spread(1, 0), Ok(&[40..41]));
    check(&lengths, spread(0, 1), Err("a selection of 0 rows"));
    let too_few = "4 episodes with 40 rows begin at or after row 11";
    check(&lengths, spread(41, 2), Err(too_few));
    check(&lengths, spread(10, 5), Err(too_few));
    check(&lengths, spread(2, 3), Err("2 held-out rows from at least 3 episodes"));
    // Short episodes give all that they have, longer ones the rest.
    check(&[1, 2, 9, 9], HeldOut::spread(11, 4).after(0), Ok(&[0..1, 1..3, 6..10, 17..21]));
}

proptest! {
    #[test]
    fn spread_rows_are_what_was_asked_for(
        lengths in prop::collection::vec(1..40usize, 1..60),
        training_rows in 0..400usize, rows in 1..300usize, min_episodes in 1..30usize,
    ) {
        let demonstrations = demonstrations(&lengths);
        let selection = HeldOut::spread(rows, min_episodes).after(training_rows);
        let unseen: Vec<&Range<usize>> = demonstrations.outline()
            .episodes
            .iter()
            .filter(|episode| episode.start >= training_rows)
            .collect();
        let available: usize = unseen.iter().map(|episode| episode.len()).sum();
        let is_possible = available >= rows && unseen.len().min(rows) >= min_episodes;
        let ranges = selection.row_ranges(demonstrations.outline());
        prop_assert_eq!(ranges.is_ok(), is_possible);
        let Ok(ranges) = ranges else { return Ok(()) };
        prop_assert_eq!(ranges.iter().map(ExactSizeIterator::len).sum::<usize>(), rows);
        prop_assert!(ranges.len() >= min_episodes);
        let home = |range: &Range<usize>| {
            unseen.iter().position(|episode| {
                !range.is_empty() && episode.start <= range.start && range.end <= episode.end
            })
        };
        let homes: Option<Vec<usize>> = ranges.iter().map(home).collect();
        prop_assert!(homes.is_some(), "a run in no unseen episode: {:?}", ranges);
        // Ascending, each in an episode of its own.
        prop_assert!(homes.as_ref().unwrap().is_sorted_by(|a, b| a < b));
        // Only an episode that gives all it has gives fewer rows than another, but for one.
        let longest = ranges.iter().map(ExactSizeIterator::len).max().unwrap();
        for (range, home) in ranges.iter().zip(homes.unwrap()) {
            prop_assert!(range.len() + 1 >= longest || range.len() == unseen[home].len());
        }
        prop_assert_eq!(selection.row_ranges(demonstrations.outline()), Ok(ranges));
    }

    #[test]
    fn consecutive_rows_are_all_of_them_once(
        lengths in prop::collection::vec(1..9usize, 1..9), start in 0..40usize, rows in 1..40usize,
    ) {
        let demonstrations = demonstrations(&lengths);
        let Ok(ranges) = HeldOut::slice(start, rows).after(0).row_ranges(demonstrations.outline()) else {
            prop_assert!(start + rows > demonstrations.outline().transitions());
            return Ok(());
        };
        let flat: Vec<usize> = ranges.iter().cloned().flatten().collect();
        prop_assert_eq!(flat, (start..start + rows).collect::<Vec<_>>());
        for episode in &demonstrations.outline().episodes {
            let inside = |range: &&Range<usize>| episode.contains(&range.start);
            prop_assert!(ranges.iter().filter(inside).count() <= 1);
        }
    }
}
