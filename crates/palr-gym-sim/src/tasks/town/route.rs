//! Ways through a town: streets along the right lane, joined by quarter circles.

use std::f64::consts::FRAC_PI_2;

use palr_gym_core::random::Generator;

use super::super::driving::{LANE_WIDTH_M, Place, wrap_angle};
use super::map::{HEADINGS, Map, NODES, below, direction, neighbour, node_m, opposite};
use super::{BLOCK_M, JUNCTION_M};

/// The right lane's middle, from the street's.
const LANE_OFFSET_M: f64 = LANE_WIDTH_M / 2.0;
/// From junction to junction.
pub(super) const STREET_M: f64 = BLOCK_M - 2.0 * JUNCTION_M;
/// Junctions between a start and its goal, as the shortest way has them.
const GOAL_JUNCTIONS: (u8, u8) = (3, 4);
/// A goal is this far into its street.
const GOAL_M: f64 = STREET_M / 2.0;
/// Headings of the longest route.
pub(super) const MAX_HEADINGS: usize = GOAL_JUNCTIONS.1 as usize + 1;
/// A car is looked for this far before and behind where it was.
const SEARCH_M: f64 = 8.0;
/// Stands for no turn ahead.
pub(super) const NO_TURN_M: f64 = 100.0;

/// A street and what follows at its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Leg {
    /// The junction that it leaves.
    pub(super) from: usize,
    pub(super) heading: usize,
    /// In which it leaves the junction at its end.
    pub(super) out: usize,
}

/// Something as seen from a route.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Projection {
    pub(super) progress_m: f64,
    /// From the lane's middle, positive to the left.
    pub(super) offset_m: f64,
    pub(super) heading_rad: f64,
    /// Positive in a left turn.
    pub(super) curvature_per_m: f64,
}

/// A way from the junction `from`, in the order of its headings. It goes on straight after the last.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Route {
    pub(super) from: usize,
    pub(super) headings: [usize; MAX_HEADINGS],
    /// Of `headings`, from 1 on.
    pub(super) len: usize,
}

impl Leg {
    /// The junction at its end; on a map, there is one.
    pub(super) fn via(&self) -> usize {
        neighbour(self.from, self.heading).unwrap_or(self.from)
    }

    /// 1 to the left, -1 to the right, 0 straight on.
    pub(super) fn turn(&self) -> f64 {
        match (self.out + 4 - self.heading) % 4 {
            1 => 1.0,
            3 => -1.0,
            _ => 0.0,
        }
    }

    /// Radius of its turn: from the middle of the lane to the corner of the junction.
    fn radius_m(&self) -> f64 {
        JUNCTION_M + self.turn() * LANE_OFFSET_M
    }

    /// The way through the junction.
    fn crossing_m(&self) -> f64 {
        if self.turn() == 0.0 { 2.0 * JUNCTION_M } else { FRAC_PI_2 * self.radius_m() }
    }

    pub(super) fn length_m(&self) -> f64 {
        STREET_M + self.crossing_m()
    }

    fn heading_rad(&self) -> f64 {
        wrap_angle(self.heading as f64 * FRAC_PI_2)
    }

    /// In the frame of the leg: from where it begins, along its street and to the left.
    fn local(&self, position_m: [f64; 2]) -> [f64; 2] {
        let (node, [ux, uy]) = (node_m(self.from), direction(self.heading));
        let (x, y) = (position_m[0] - node[0], position_m[1] - node[1]);
        [x * ux + y * uy - JUNCTION_M, y * ux - x * uy + LANE_OFFSET_M]
    }

    /// The place `along_m` from its begin and `aside_m` to the left; beyond its end, straight on.
    pub(super) fn place(&self, along_m: f64, aside_m: f64) -> Place {
        let beyond_m = along_m - STREET_M;
        let turn = self.turn();
        let ([x, y], angle) = if beyond_m <= 0.0 || turn == 0.0 {
            ([along_m, aside_m], 0.0)
        } else {
            let radius_m = self.radius_m();
            let angle = (beyond_m / radius_m).min(FRAC_PI_2);
            let after_m = beyond_m - angle * radius_m;
            let out_m = radius_m - turn * aside_m;
            let (sin, cos) = angle.sin_cos();
            let arc = [STREET_M + out_m * sin, turn * (radius_m - out_m * cos)];
            ([arc[0] + after_m * cos, arc[1] + turn * after_m * sin], turn * angle)
        };
        let (node, [ux, uy]) = (node_m(self.from), direction(self.heading));
        let (x, y) = (x + JUNCTION_M, y - LANE_OFFSET_M);
        Place {
            position_m: [node[0] + x * ux - y * uy, node[1] + x * uy + y * ux],
            heading_rad: wrap_angle(self.heading_rad() + angle),
        }
    }

    /// The nearest of its places, and how far that is.
    fn project(&self, position_m: [f64; 2]) -> (Projection, f64) {
        let [x, y] = self.local(position_m);
        let (turn, length_m) = (self.turn(), self.length_m());
        let straight_m = if turn == 0.0 { length_m } else { STREET_M };
        let along_m = x.clamp(0.0, straight_m);
        let heading_rad = self.heading_rad();
        let straight =
            Projection { progress_m: along_m, offset_m: y, heading_rad, curvature_per_m: 0.0 };
        let straight = (straight, (x - along_m).hypot(y));
        if turn == 0.0 {
            return straight;
        }
        let radius_m = self.radius_m();
        let (ahead_m, inward_m) = (x - STREET_M, radius_m - turn * y);
        let angle = ahead_m.atan2(inward_m).clamp(0.0, FRAC_PI_2);
        let (sin, cos) = angle.sin_cos();
        let arc = Projection {
            progress_m: STREET_M + angle * radius_m,
            offset_m: turn * (radius_m - ahead_m.hypot(inward_m)),
            heading_rad: wrap_angle(heading_rad + turn * angle),
            curvature_per_m: turn / radius_m,
        };
        let away_m = (ahead_m - radius_m * sin).hypot(inward_m - radius_m * cos);
        if away_m < straight.1 { (arc, away_m) } else { straight }
    }
}

impl Route {
    /// A shortest way from the street that leaves `from` in `heading` to a goal, which is drawn among
    /// all that are so many junctions away.
    pub(super) fn draw(map: &Map, from: usize, heading: usize, generator: &mut Generator) -> Self {
        let start = from * 4 + heading;
        // Junctions on the shortest way to each street and direction.
        let mut junctions = [u8::MAX; 4 * NODES];
        junctions[start] = 0;
        for count in 0..GOAL_JUNCTIONS.1 {
            for way in 0..junctions.len() {
                let Some(node) = neighbour(way / 4, way % 4).filter(|_| junctions[way] == count)
                else {
                    continue;
                };
                for out in map.ways_on(node, way % 4) {
                    let next = &mut junctions[node * 4 + out];
                    *next = (*next).min(count + 1);
                }
            }
        }
        let goals = || {
            let is_goal =
                |way: &usize| (GOAL_JUNCTIONS.0..=GOAL_JUNCTIONS.1).contains(&junctions[*way]);
            (0..junctions.len()).filter(is_goal)
        };
        let mut way = goals().nth(below(generator, goals().count())).unwrap_or(start);
        let mut route = Self { from, headings: [heading; MAX_HEADINGS], len: 1 };
        // From the goal back: any of the shortest ways.
        let mut left = if way == start { 0 } else { usize::from(junctions[way]) };
        route.len = left + 1;
        while left > 0 {
            route.headings[left] = way % 4;
            let before = || {
                let (node, out) = (way / 4, way % 4);
                let into = move |h: usize| neighbour(node, opposite(h)).map(|p| p * 4 + h);
                HEADINGS
                    .into_iter()
                    .filter(move |&h| h != opposite(out))
                    .filter_map(into)
                    .filter(|&way| map.has(way / 4, way % 4))
                    .filter(|&way| usize::from(junctions[way]) + 1 == left)
            };
            way = before().nth(below(generator, before().count())).unwrap_or(start);
            left -= 1;
        }
        route
    }

    /// Its streets, with where each begins.
    fn legs(&self) -> impl Iterator<Item = (f64, Leg)> {
        let (mut from, mut begin_m) = (self.from, 0.0);
        (0..self.len).map(move |i| {
            let heading = self.headings[i];
            let out = if i + 1 < self.len { self.headings[i + 1] } else { heading };
            let (leg, here_m) = (Leg { from, heading, out }, begin_m);
            from = leg.via();
            begin_m += leg.length_m();
            (here_m, leg)
        })
    }

    /// Where the goal is.
    pub(super) fn goal_m(&self) -> f64 {
        self.last().0 + GOAL_M
    }

    /// The goal's street, and where it begins.
    pub(super) fn last(&self) -> (f64, Leg) {
        let whole = Leg { from: self.from, heading: self.headings[0], out: self.headings[0] };
        self.legs().last().unwrap_or((0.0, whole))
    }

    /// The street at a place, and where it begins.
    pub(super) fn leg_at(&self, progress_m: f64) -> (f64, Leg) {
        let ends_later = |&(begin_m, leg): &(f64, Leg)| progress_m < begin_m + leg.length_m();
        self.legs().find(ends_later).unwrap_or_else(|| self.last())
    }

    /// The place `progress_m` along it.
    pub(super) fn place(&self, progress_m: f64, aside_m: f64) -> Place {
        let (begin_m, leg) = self.leg_at(progress_m);
        leg.place(progress_m - begin_m, aside_m)
    }

    /// The nearest place to a car that was at `near_m` a moment ago.
    pub(super) fn project(&self, position_m: [f64; 2], near_m: f64) -> Projection {
        self.project_within(position_m, near_m - SEARCH_M, near_m + SEARCH_M).0
    }

    /// The nearest place on the streets that reach into a range, and how far it is.
    pub(super) fn project_within(
        &self,
        position_m: [f64; 2],
        first_m: f64,
        last_m: f64,
    ) -> (Projection, f64) {
        let (range_begin_m, leg) = self.leg_at(first_m);
        let (mut nearest, mut away_m) = leg.project(position_m);
        nearest.progress_m += range_begin_m;
        for (begin_m, leg) in self.legs() {
            if begin_m > range_begin_m && begin_m <= last_m {
                let (found, found_away_m) = leg.project(position_m);
                if found_away_m < away_m {
                    (nearest, away_m) = (found, found_away_m);
                    nearest.progress_m += begin_m;
                }
            }
        }
        (nearest, away_m)
    }

    /// From a place to where the next turn begins: 0 in one, [`NO_TURN_M`] if there is none.
    pub(super) fn turn_distance_m(&self, progress_m: f64) -> f64 {
        self.legs()
            .filter(|(begin_m, leg)| leg.turn() != 0.0 && progress_m < begin_m + leg.length_m())
            .map(|(begin_m, _)| (begin_m + STREET_M - progress_m).max(0.0))
            .next()
            .unwrap_or(NO_TURN_M)
    }
}
