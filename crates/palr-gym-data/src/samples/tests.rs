use std::path::Path;

use ndarray::{Array1, s};
use proptest::prelude::*;

use super::*;
use crate::demonstrations::{Arrays, Demonstrations};
use crate::selection::HeldOut;

const D: usize = 5;
const A: usize = 2;

/// Never zero, so that padding is told from data.
fn observation(t: usize, j: usize) -> f32 {
    (1 + t * D + j) as f32
}

fn action(t: usize, j: usize) -> f32 {
    (1 + t * A + j) as f32 / -1024.0
}

/// Episodes of the given lengths, ended by the task and by time in turn.
fn demonstrations_of(lengths: &[usize], columns: usize, env_id: Option<&str>) -> Demonstrations {
    let n: usize = lengths.iter().sum();
    let mut flags = [Array1::from_elem(n, false), Array1::from_elem(n, false)];
    let mut end = 0;
    for (i, length) in lengths.iter().enumerate() {
        end += length;
        flags[i % 2][end - 1] = true;
    }
    let [terminals, timeouts] = flags;
    let arrays = Arrays {
        observations: Array2::from_shape_fn((n, columns), |(t, j)| observation(t, j)),
        actions: Array2::from_shape_fn((n, A), |(t, j)| action(t, j)),
        rewards: Array1::zeros(n),
        terminals,
        timeouts,
    };
    Demonstrations::new(Path::new("data.hdf5"), env_id.map(str::to_owned), arrays).unwrap()
}

fn demonstrations(lengths: &[usize]) -> Demonstrations {
    demonstrations_of(lengths, D, None)
}

fn view(mask_indices: &[usize], frame_stack: usize) -> View {
    View {
        task: "hopper".to_owned(),
        recorded_as: Mask::Full,
        full_observation_size: D,
        action_size: A,
        mask_indices: mask_indices.to_vec(),
        frame_stack,
        fidelity: Fidelity::Gym4,
    }
}

/// Lengths of episodes, a view, and the start and length of a slice that fits.
fn cases() -> impl Strategy<Value = (Vec<usize>, View, usize, usize)> {
    let lengths = prop::collection::vec(1..12usize, 1..8);
    let mask = prop::sample::subsequence((0..D).collect::<Vec<_>>(), 1..=D);
    (lengths, mask, 1..7usize).prop_flat_map(|(lengths, mask, frame_stack)| {
        let n: usize = lengths.iter().sum();
        (0..n).prop_flat_map(move |start| {
            let view = view(&mask, frame_stack);
            (Just(lengths.clone()), Just(view), Just(start), 1..=n - start)
        })
    })
}

proptest! {
    /// The definition, entry by entry, without a stack: frame k of row t is observation
    /// t - w + 1 + k, or zeros if the episode begins later than that.
    #[test]
    fn samples_are_what_the_definition_says((lengths, view, start, rows) in cases()) {
        let samples = Samples::select(
            &demonstrations(&lengths), &view, HeldOut::slice(start, rows).after(0),
        ).unwrap();
        let w = view.frame_stack;
        let d = view.mask_indices.len();
        prop_assert_eq!(samples.observations.dim(), (rows, w * d));
        prop_assert_eq!(samples.actions.dim(), (rows, A));
        prop_assert_eq!(samples.past_actions.dim(), (rows, A));
        let begins: Vec<usize> = lengths
            .iter()
            .scan(0, |end, length| { *end += length; Some(*end - length) })
            .collect();
        for i in 0..rows {
            let t = start + i;
            let begin = *begins.iter().rfind(|&&begin| begin <= t).unwrap();
            for k in 0..w {
                for (j, &index) in view.mask_indices.iter().enumerate() {
                    let is_padding = t + k + 1 < begin + w;
                    let expected = if is_padding { 0.0 } else { observation(t + k + 1 - w, index) };
                    prop_assert_eq!(samples.observations[(i, k * d + j)], expected);
                }
            }
            for j in 0..A {
                prop_assert_eq!(samples.actions[(i, j)], action(t, j));
                let expected = if t == begin { 0.0 } else { action(t - 1, j) };
                prop_assert_eq!(samples.past_actions[(i, j)], expected);
            }
        }
        let mut counts = Vec::new();
        for (begin, length) in begins.iter().zip(&lengths) {
            let inside = (start..start + rows).filter(|t| (*begin..begin + length).contains(t));
            counts.push(inside.count());
        }
        counts.retain(|&count| count > 0);
        prop_assert_eq!(samples.episode_lengths, counts);
    }

    /// An agent that lives through the episodes, as the simulation would have it: `clear` at each
    /// reset, one `push` for each observation.
    #[test]
    fn stacks_are_those_that_an_agent_sees_online((lengths, view, start, rows) in cases()) {
        let demonstrations = demonstrations(&lengths);
        let mut agent = FrameStack::new(view.mask_indices.len(), view.frame_stack);
        let mut seen = Vec::new();
        let mut is_new_episode = true;
        let outline = demonstrations.outline();
        let all = demonstrations.rows(0..outline.transitions()).unwrap();
        for t in 0..outline.transitions() {
            if is_new_episode {
                agent.clear();
            }
            let full = all.observations.row(t);
            agent.push(view.mask_indices.iter().map(|&index| f64::from(full[index])));
            seen.push(agent.stacked().to_vec());
            is_new_episode = outline.episodes.iter().any(|episode| episode.end == t + 1);
        }
        let selection = HeldOut::slice(start, rows).after(0);
        let samples = Samples::select(&demonstrations, &view, selection).unwrap();
        for (stack, seen) in samples.observations.rows().into_iter().zip(&seen[start..]) {
            prop_assert_eq!(&stack.mapv(f64::from).to_vec(), seen);
        }
    }

    #[test]
    fn a_row_is_the_same_sample_in_every_selection((lengths, view, start, rows) in cases()) {
        let demonstrations = demonstrations(&lengths);
        let n = demonstrations.outline().transitions();
        let all = Samples::select(&demonstrations, &view, Selection::first(n)).unwrap();
        prop_assert_eq!(&all.episode_lengths, &lengths);
        let episodes = 1 + rows % lengths.len();
        for selection in [
            HeldOut::slice(start, rows).after(start),
            HeldOut::spread(rows.max(episodes), episodes).after(0),
        ] {
            let some = Samples::select(&demonstrations, &view, selection).unwrap();
            let mut slot = 0;
            for range in selection.row_ranges(demonstrations.outline()).unwrap() {
                let (from, to) = (s![range.clone(), ..], s![slot..slot + range.len(), ..]);
                prop_assert_eq!(some.observations.slice(to), all.observations.slice(from));
                prop_assert_eq!(some.actions.slice(to), all.actions.slice(from));
                prop_assert_eq!(some.past_actions.slice(to), all.past_actions.slice(from));
                slot += range.len();
            }
            prop_assert_eq!(some.rows(), slot);
        }
    }
}

#[test]
fn the_first_step_of_an_episode_has_zeros_before_it() {
    let samples =
        Samples::select(&demonstrations(&[2, 2]), &view(&[0, 3], 3), Selection::first(4)).unwrap();
    let expected = ndarray::arr2(&[
        [0.0, 0.0, 0.0, 0.0, 1.0, 4.0],
        [0.0, 0.0, 1.0, 4.0, 6.0, 9.0],
        [0.0, 0.0, 0.0, 0.0, 11.0, 14.0],
        [0.0, 0.0, 11.0, 14.0, 16.0, 19.0],
    ]);
    assert_eq!(samples.observations, expected);
    assert_eq!(samples.past_actions.row(2).to_vec(), [0.0, 0.0]);
    assert_eq!(samples.past_actions.row(3).to_vec(), [action(2, 0), action(2, 1)]);
    assert_eq!(samples.episode_lengths, [2, 2]);
}

#[test]
fn ant_with_contact_forces_is_ant_without() {
    let view = View {
        task: "ant".to_owned(),
        recorded_as: Mask::Full,
        full_observation_size: 27,
        mask_indices: (0..13).collect(),
        ..view(&[], 2)
    };
    for columns in [27, 105, 111] {
        let demonstrations = demonstrations_of(&[3], columns, None);
        let samples = Samples::select(&demonstrations, &view, Selection::first(3)).unwrap();
        let last = Array1::from_shape_fn(13, |j| observation(2, j));
        assert_eq!(samples.observations.slice(s![2, 13..]), last, "{columns}");
    }
    let demonstrations = demonstrations_of(&[3], 29, None);
    let error = Samples::select(&demonstrations, &view, Selection::first(3)).unwrap_err();
    assert_eq!(
        error.to_string(),
        "data.hdf5: observations has 29 columns; ant's full observation has 27 (or 105 or 111): \
         is this data of another task, or masked already?"
    );
}

#[test]
fn data_of_another_task_and_senseless_views_are_refused() {
    #[track_caller]
    fn check(view: &View, columns: usize, env_id: Option<&str>, expected: Result<(), &str>) {
        let demonstrations = demonstrations_of(&[3], columns, env_id);
        let got = Samples::select(&demonstrations, view, Selection::first(3));
        match (got.map(drop).map_err(|error| error.to_string()), expected) {
            (Ok(()), Ok(())) => {}
            (Err(got), Err(expected)) => assert!(got.contains(expected), "{got}"),
            (got, expected) => panic!("got {got:?}, expected {expected:?}"),
        }
    }
    let hopper = view(&[0, 1], 2);
    check(&hopper, D, Some("hopper-v0"), Ok(()));
    check(&hopper, D, Some("Hopper-v4"), Ok(()));
    check(&hopper, D, Some("hopper-gym5"), Err("holds data of hopper-gym5; expected full"));
    check(&hopper, D, Some("Hopper-v5"), Err("holds data of Hopper-v5; expected full"));
    let newer = View { fidelity: Fidelity::Gym5, ..hopper.clone() };
    check(&newer, D, Some("Hopper-v5"), Ok(()));
    check(&newer, D, Some("hopper-gym5"), Ok(()));
    check(&newer, D, Some("hopper-v0"), Err("of hopper, as of hopper-gym5-v0"));
    check(&hopper, 17, None, Err("observations has 17 columns; hopper's full observation has 5:"));
    check(&hopper, 105, None, Err("observations has 105 columns"));
    check(
        &hopper,
        D,
        Some("walker2d-v0"),
        Err("data.hdf5: holds data of walker2d-v0; expected full single observations of hopper"),
    );
    check(&hopper, D, Some("hopper-strict"), Err("holds data of hopper-strict"));
    check(&hopper, D, Some("hopper-w2-v0"), Err("holds data of hopper-w2-v0"));
    let walker = View { action_size: 6, ..hopper };
    check(&walker, D, None, Err("actions has 2 columns; hopper's full action has 6:"));
    check(&view(&[], 1), D, None, Err("the view of hopper keeps no columns"));
    check(&view(&[1, 5], 1), D, None, Err("keeps column 5 of a full observation of 5"));
    check(&view(&[1], 0), D, None, Err("a frame stack of 0; expected 1 to 64"));
    check(&view(&[1], 65), D, None, Err("a frame stack of 65; expected 1 to 64"));
}
