//! The pieces of which maps are made, and which of them a map has.

use super::map::{Map, NODES, ROWS, STREETS};
use crate::render::Pieces;

/// Sets of arms that a junction may have.
const ARMS: usize = 16;
/// The number of the first piece of each kind; 0 marks what every map has.
const FIRST_STREET: usize = 1;
const FIRST_JUNCTION: usize = FIRST_STREET + STREETS;
const FIRST_ROW: usize = FIRST_JUNCTION + NODES * ARMS;
const FIRST_PARK: usize = FIRST_ROW + STREETS * 2 * ROWS;
#[cfg(test)]
pub(super) const COUNT: usize = FIRST_PARK + STREETS;

/// A street between two junctions.
pub(super) fn street(street: usize) -> usize {
    FIRST_STREET + street
}

/// A junction with these arms.
pub(super) fn junction(node: usize, arms: usize) -> usize {
    FIRST_JUNCTION + node * ARMS + arms
}

/// A row of buildings on a street's left (0) or right (1) side.
pub(super) fn row(street: usize, side: usize, row: usize) -> usize {
    FIRST_ROW + (street * 2 + side) * ROWS + row
}

/// Trees where a street could be.
pub(super) fn park(street: usize) -> usize {
    FIRST_PARK + street
}

/// Every piece of a map.
pub(super) fn of_map(map: &Map) -> Pieces {
    let mut pieces = Pieces::default();
    pieces.insert(0);
    for node in 0..NODES {
        pieces.insert(junction(node, map.arms(node)));
    }
    for index in 0..STREETS {
        if map.has_street(index) {
            pieces.insert(street(index));
            for side in [0, 1] {
                pieces.insert(row(index, side, map.row(index, side)));
            }
        } else {
            pieces.insert(park(index));
        }
    }
    pieces
}
