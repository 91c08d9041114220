//! The streets of a town: a grid of junctions from which some streets are left out.

use palr_gym_core::random::Generator;

use super::super::driving::LANE_WIDTH_M;
use super::{BLOCK_M, JUNCTION_M};

/// Junctions each way.
pub(super) const SIDE: usize = 4;
pub(super) const NODES: usize = SIDE * SIDE;
/// Streets of the whole grid: those that run east, row by row, then those that run north.
pub(super) const STREETS: usize = 2 * SIDE * (SIDE - 1);
const EASTWARD: usize = SIDE * (SIDE - 1);
/// East, north, west, south.
pub(super) const HEADINGS: [usize; 4] = [0, 1, 2, 3];
/// Streets that a map lacks: at least, and how many choices from there.
const FEWEST_LACKING: usize = 3;
const LACKING_CHOICES: usize = 4;
/// Tries to find streets that a town can do without; a third of all choices will do.
const TRIES: usize = 200;
/// Rows of buildings among which each side of a street chooses.
pub(super) const ROWS: usize = 2;

/// Which streets there are, and which row of buildings stands on each of their sides.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Map {
    /// Bit by bit.
    pub(super) streets: u32,
    /// Two bits a street, left and right.
    pub(super) rows: u64,
}

/// A unit step.
pub(super) fn direction(heading: usize) -> [f64; 2] {
    [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]][heading % 4]
}

pub(super) fn opposite(heading: usize) -> usize {
    (heading + 2) % 4
}

/// The middle of a junction.
pub(super) fn node_m(node: usize) -> [f64; 2] {
    let at = |k: usize| (k as f64 - (SIDE as f64 - 1.0) / 2.0) * BLOCK_M;
    [at(node % SIDE), at(node / SIDE % SIDE)]
}

/// The junction that follows in a direction.
pub(super) fn neighbour(node: usize, heading: usize) -> Option<usize> {
    let (x, y) = (node % SIDE, node / SIDE);
    match heading {
        0 if x + 1 < SIDE => Some(node + 1),
        1 if y + 1 < SIDE => Some(node + SIDE),
        2 if x > 0 => Some(node - 1),
        3 if y > 0 => Some(node - SIDE),
        _ => None,
    }
}

/// The street of the grid that leaves a junction in a direction.
pub(super) fn street(node: usize, heading: usize) -> Option<usize> {
    let next = neighbour(node, heading)?;
    let first = node.min(next);
    Some(if heading.is_multiple_of(2) {
        first / SIDE * (SIDE - 1) + first % SIDE
    } else {
        EASTWARD + first
    })
}

/// Where a street begins, and its heading from there: east or north.
pub(super) fn ends(street: usize) -> (usize, usize) {
    if street < EASTWARD {
        (street / (SIDE - 1) * SIDE + street % (SIDE - 1), 0)
    } else {
        (street - EASTWARD, 1)
    }
}

impl Map {
    const EVERY_STREET: u32 = (1 << STREETS) - 1;

    /// A connected town whose junctions have two to four streets, with some of each.
    pub(super) fn draw(generator: &mut Generator) -> Self {
        let streets = (0..TRIES)
            .map(|_| Self { streets: lacking_some(generator), rows: 0 })
            .find(|map| map.is_town())
            .map_or(Self::EVERY_STREET, |map| map.streets);
        Self { streets, rows: generator.next_u64() & ((1 << (2 * STREETS)) - 1) }
    }

    /// True if a street leaves the junction in that direction.
    pub(super) fn has(&self, node: usize, heading: usize) -> bool {
        street(node, heading).is_some_and(|street| self.has_street(street))
    }

    pub(super) fn has_street(&self, street: usize) -> bool {
        self.streets >> street & 1 == 1
    }

    /// The row of buildings on a street's left (0) or right (1) side.
    pub(super) fn row(&self, street: usize, side: usize) -> usize {
        (self.rows >> (2 * street + side) & 1) as usize
    }

    /// The streets of a junction, bit by bit in the order of [`HEADINGS`].
    pub(super) fn arms(&self, node: usize) -> usize {
        HEADINGS.into_iter().filter(|&heading| self.has(node, heading)).map(|bit| 1 << bit).sum()
    }

    pub(super) fn degree(&self, node: usize) -> u32 {
        self.arms(node).count_ones()
    }

    /// The ways on from a street: every one but back.
    pub(super) fn ways_on(&self, node: usize, heading: usize) -> impl Iterator<Item = usize> {
        HEADINGS.into_iter().filter(move |&out| out != opposite(heading) && self.has(node, out))
    }

    fn is_town(&self) -> bool {
        let degrees = || (0..NODES).map(|node| self.degree(node));
        if degrees().any(|degree| degree < 2) || ![3, 4].iter().all(|d| degrees().any(|n| n == *d))
        {
            return false;
        }
        let mut reached = [false; NODES];
        reached[0] = true;
        // As far as any junction can be from the first.
        for _ in 0..NODES {
            for node in 0..NODES {
                for heading in HEADINGS {
                    if let Some(next) = neighbour(node, heading)
                        && reached[node]
                        && self.has(node, heading)
                    {
                        reached[next] = true;
                    }
                }
            }
        }
        reached.into_iter().all(|is_reached| is_reached)
    }

    /// True on the lanes and in the junctions: within the edge lines.
    pub(super) fn is_on_road(&self, position_m: [f64; 2]) -> bool {
        let nearest = |value: f64| {
            let at = value / BLOCK_M + (SIDE as f64 - 1.0) / 2.0;
            (at.round().max(0.0) as usize).min(SIDE - 1)
        };
        let node = nearest(position_m[1]) * SIDE + nearest(position_m[0]);
        let middle_m = node_m(node);
        let (x, y) = (position_m[0] - middle_m[0], position_m[1] - middle_m[1]);
        let arms = self.arms(node);
        let has = |heading: usize| arms >> heading & 1 == 1;
        let is_near = x.abs() <= JUNCTION_M && y.abs() <= JUNCTION_M;
        let bend = HEADINGS.into_iter().find(|&first| arms == 1 << first | 1 << ((first + 1) % 4));
        // A corner's kerb is a circle about the point where the streets' boxes meet.
        let corner = |first: usize| {
            let [ax, ay] = direction(first);
            let [bx, by] = direction((first + 1) % 4);
            (x - JUNCTION_M * (ax + bx)).hypot(y - JUNCTION_M * (ay + by))
        };
        if let (true, Some(first)) = (is_near, bend) {
            let range = JUNCTION_M - LANE_WIDTH_M..=JUNCTION_M + LANE_WIDTH_M;
            return range.contains(&corner(first));
        }
        HEADINGS.into_iter().filter(|&heading| has(heading)).any(|heading| {
            let [along, across] = seen_along(heading, [x, y]);
            let is_in_street = along >= -LANE_WIDTH_M && across.abs() <= LANE_WIDTH_M;
            let is_in_corner = is_near
                && has((heading + 1) % 4)
                && (0.0..=JUNCTION_M).contains(&along)
                && (0.0..=JUNCTION_M).contains(&across)
                && corner(heading) >= JUNCTION_M - LANE_WIDTH_M;
            is_in_street || is_in_corner
        })
    }
}

/// How far a vector goes in a direction, and to the left of it.
pub(super) fn seen_along(heading: usize, vector: [f64; 2]) -> [f64; 2] {
    let ([x, y], [ux, uy]) = (vector, direction(heading));
    [x * ux + y * uy, y * ux - x * uy]
}

/// Every street but three to six, of those that no corner of the grid needs.
fn lacking_some(generator: &mut Generator) -> u32 {
    let whole = Map { streets: Map::EVERY_STREET, rows: 0 };
    let is_spare = |street: &usize| {
        let (node, heading) = ends(*street);
        let other = neighbour(node, heading).unwrap_or(node);
        whole.degree(node) > 2 && whole.degree(other) > 2
    };
    let count = FEWEST_LACKING + below(generator, LACKING_CHOICES);
    let mut streets = Map::EVERY_STREET;
    for _ in 0..count {
        let spare = || (0..STREETS).filter(is_spare).filter(|street| streets >> street & 1 == 1);
        let lacking = spare().nth(below(generator, spare().count()));
        if let Some(street) = lacking {
            streets &= !(1 << street);
        }
    }
    streets
}

/// A uniform choice among `count`.
pub(super) fn below(generator: &mut Generator, count: usize) -> usize {
    ((generator.next_f64() * count as f64) as usize).min(count.saturating_sub(1))
}
