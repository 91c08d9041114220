//! The other vehicles: they keep their lane and their distance, take turns at random, and let
//! whoever is first into a junction pass, the car before all others.

use palr_gym_core::random::Generator;

use super::super::driving::{
    CAR_HALF_LENGTH_M, Place, STEP_S, TWO_HALF_LENGTHS_M, control, wrap_angle,
};
use super::map::{HEADINGS, Map, NODES, below, node_m};
use super::route::{Leg, MAX_HEADINGS, Route, STREET_M};
use super::state::State;
use super::{JUNCTION_M, TURN_SPEED_MPS, speed_before_turn};

/// Most vehicles of an episode.
pub(super) const MAX_VEHICLES: usize = palr_gym_core::scene_options::MAX_VEHICLES as usize;
/// Range of the speeds at which they cruise.
const CRUISE_MPS: (f64, f64) = (2.5, 5.0);
const START_SPEED: f64 = 0.5;
/// Where on a street they start.
const START_M: (f64, f64) = (3.0, STREET_M - 6.0);
/// From each other, and from the car.
const START_GAP_M: f64 = 10.0;
const START_TRIES: usize = 60;
/// Greatest braking and acceleration (m/s²).
const ACCELERATION: (f64, f64) = (-6.0, 2.0);
/// Whoever would have to brake harder than this drives into the junction (m/s²).
const HARD_BRAKING: f64 = 4.0;
/// From here a vehicle looks at the junction ahead, and is seen to come.
const JUNCTION_SEEN_M: f64 = 20.0;
/// The car comes if it will be there in this time, or is this near.
const CAR_COMES_S: f64 = 2.0;
const CAR_COMES_M: f64 = 4.0;
/// How far ahead something is followed.
const FOLLOWED_M: f64 = 40.0;
/// What is further aside than this is not in the way.
const IN_THE_WAY_M: f64 = 1.7;
/// A waiting vehicle's bumper stands this far before the junction; the driver model adds its own
/// distance at rest.
const LINE_SLACK_M: f64 = 1.5;

/// A vehicle on its way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Vehicle {
    pub(super) leg: Leg,
    /// Along the leg.
    pub(super) along_m: f64,
    pub(super) speed_mps: f64,
    /// At which it drives on a free street.
    pub(super) cruise_mps: f64,
}

/// The car that is driven, as others see it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Car {
    pub(super) position_m: [f64; 2],
    pub(super) heading_rad: f64,
    pub(super) speed_mps: f64,
    /// The leg of its route.
    pub(super) leg: Leg,
    /// Along that leg.
    pub(super) along_m: f64,
}

impl Vehicle {
    pub(super) fn place(&self) -> Place {
        self.leg.place(self.along_m, 0.0)
    }

    /// From its bumper to where the junction begins; negative inside.
    fn entry_m(&self) -> f64 {
        STREET_M - self.along_m - CAR_HALF_LENGTH_M
    }

    /// True if it can no longer stop before the junction.
    fn is_committed(&self) -> bool {
        let entry_m = self.entry_m();
        entry_m <= 0.0 || self.speed_mps * self.speed_mps > 2.0 * HARD_BRAKING * entry_m
    }

    /// True if any part of it is in the junction, or will be whatever it does.
    fn is_in(&self, node: usize) -> bool {
        let is_leaving = self.leg.from == node && self.along_m < CAR_HALF_LENGTH_M;
        is_leaving || (self.leg.via() == node && self.is_committed())
    }

    /// True if it comes from the same street in the same direction, or did so before it turned.
    fn shares(&self, leg: Leg) -> bool {
        (self.leg.from, self.leg.heading) == (leg.from, leg.heading)
    }

    /// Its way and where on it `other` is ahead: `None` if it is not.
    fn gap_to(&self, other: &Self) -> Option<f64> {
        let along_m = if self.shares(other.leg) {
            other.along_m
        } else if (other.leg.from, other.leg.heading) == (self.leg.via(), self.leg.out) {
            self.leg.length_m() + other.along_m
        } else {
            return None;
        };
        let gap_m = along_m - self.along_m;
        (gap_m > 0.0 && gap_m < FOLLOWED_M).then_some(gap_m - TWO_HALF_LENGTHS_M)
    }

    /// The same for the car, wherever it is.
    fn gap_to_car(&self, car: &Car) -> Option<(f64, f64)> {
        let mut headings = [self.leg.out; MAX_HEADINGS];
        headings[0] = self.leg.heading;
        let route = Route { from: self.leg.from, headings, len: 2 };
        ahead_on(&route, self.along_m, car.position_m, car.heading_rad, car.speed_mps)
    }
}

/// What is on a route ahead of `progress_m`: gap from bumper to bumper, and speed along the route.
pub(super) fn ahead_on(
    route: &Route,
    progress_m: f64,
    position_m: [f64; 2],
    heading_rad: f64,
    speed_mps: f64,
) -> Option<(f64, f64)> {
    let (seen, away_m) = route.project_within(position_m, progress_m, progress_m + FOLLOWED_M);
    let gap_m = seen.progress_m - progress_m;
    let is_ahead = away_m < IN_THE_WAY_M && gap_m > 0.0 && gap_m < FOLLOWED_M;
    let along = wrap_angle(heading_rad - seen.heading_rad).cos();
    is_ahead.then_some((gap_m - TWO_HALF_LENGTHS_M, (speed_mps * along).max(0.0)))
}

/// True if anything is in the junction ahead of a leg that does not come from that leg's street.
pub(super) fn is_taken(traffic: &[Vehicle], leg: Leg) -> bool {
    let node = leg.via();
    traffic.iter().any(|vehicle| vehicle.is_in(node) && !vehicle.shares(leg))
}

/// Whether the car keeps others out of the junction: it is there, or about to be, from elsewhere.
fn car_claims(car: &Car, leg: Leg) -> bool {
    let (node, [x, y]) = (leg.via(), node_m(leg.via()));
    let reach_m = JUNCTION_M + CAR_HALF_LENGTH_M;
    let [car_x, car_y] = car.position_m;
    if (car_x - x).abs().max((car_y - y).abs()) < reach_m {
        return true;
    }
    let comes_by = (car.leg.from, car.leg.heading);
    let entry_m = STREET_M - car.along_m - CAR_HALF_LENGTH_M;
    car.leg.via() == node
        && comes_by != (leg.from, leg.heading)
        && entry_m < CAR_COMES_M.max(CAR_COMES_S * car.speed_mps)
}

/// Draws every vehicle's start, whether it will be there or not, so that a seed means the same start
/// for any number of them.
pub(super) fn draw(map: &Map, car: &Car, generator: &mut Generator) -> [Vehicle; MAX_VEHICLES] {
    let nowhere = Leg { from: 0, heading: 0, out: 0 };
    let parked = Vehicle { leg: nowhere, along_m: 0.0, speed_mps: 0.0, cruise_mps: 0.0 };
    let mut vehicles = [parked; MAX_VEHICLES];
    for k in 0..MAX_VEHICLES {
        for _ in 0..START_TRIES {
            let (from, heading) = draw_way(map, generator);
            let leg = draw_leg(map, from, heading, generator);
            let along_m = generator.uniform(START_M.0, START_M.1);
            let is_free = |other: Leg, other_m: f64| {
                (other.from, other.heading) != (from, heading)
                    || (other_m - along_m).abs() > START_GAP_M
            };
            vehicles[k] = Vehicle { leg, along_m, ..parked };
            let others = vehicles[..k].iter().map(|other| (other.leg, other.along_m));
            if others.chain([(car.leg, car.along_m)]).all(|(leg, at_m)| is_free(leg, at_m)) {
                break;
            }
        }
        vehicles[k].cruise_mps = generator.uniform(CRUISE_MPS.0, CRUISE_MPS.1);
        vehicles[k].speed_mps = generator.uniform(0.0, START_SPEED) * vehicles[k].cruise_mps;
    }
    vehicles
}

/// Any street of the map, in either direction.
pub(super) fn draw_way(map: &Map, generator: &mut Generator) -> (usize, usize) {
    let ways = || {
        (0..NODES)
            .flat_map(|node| HEADINGS.map(|heading| (node, heading)))
            .filter(|&(node, heading)| map.has(node, heading))
    };
    ways().nth(below(generator, ways().count())).unwrap_or((0, 0))
}

/// The street with a way on that is drawn among all.
fn draw_leg(map: &Map, from: usize, heading: usize, generator: &mut Generator) -> Leg {
    let via = Leg { from, heading, out: heading }.via();
    let ways = || map.ways_on(via, heading);
    let out = ways().nth(below(generator, ways().count())).unwrap_or(heading);
    Leg { from, heading, out }
}

/// Moves every vehicle on by a step.
pub(super) fn advance(state: &mut State, car: &Car, generator: &mut Generator) {
    for k in 0..state.traffic().len() {
        let acceleration = acceleration(state.traffic(), k, car);
        let vehicle = &mut state.vehicles[k];
        let change = acceleration.clamp(ACCELERATION.0, ACCELERATION.1) * STEP_S;
        vehicle.speed_mps = (vehicle.speed_mps + change).max(0.0);
        vehicle.along_m += vehicle.speed_mps * STEP_S;
        let length_m = vehicle.leg.length_m();
        if vehicle.along_m >= length_m {
            vehicle.along_m -= length_m;
            vehicle.leg = draw_leg(&state.map, vehicle.leg.via(), vehicle.leg.out, generator);
        }
    }
}

fn acceleration(traffic: &[Vehicle], k: usize, car: &Car) -> f64 {
    let own = &traffic[k];
    let speed = own.speed_mps;
    let in_turn = own.leg.turn() != 0.0;
    let wanted = match own.along_m - STREET_M {
        _ if !in_turn => own.cruise_mps,
        beyond_m if beyond_m >= 0.0 => own.cruise_mps.min(TURN_SPEED_MPS),
        before_m => own.cruise_mps.min(speed_before_turn(-before_m)),
    };
    let mut acceleration = control::reach(speed, wanted);
    let others = || traffic.iter().enumerate().filter(|&(other, _)| other != k);
    for (_, other) in others() {
        if let Some(gap_m) = own.gap_to(other) {
            acceleration = acceleration.min(control::follow(speed, gap_m, other.speed_mps));
        }
    }
    if let Some((gap_m, lead_mps)) = own.gap_to_car(car) {
        acceleration = acceleration.min(control::follow(speed, gap_m, lead_mps));
    }
    let entry_m = own.entry_m();
    if entry_m < JUNCTION_SEEN_M && !own.is_committed() {
        // First come, first served; of two at once, the one that is listed first.
        let is_first = others().all(|(other, vehicle)| {
            vehicle.leg.via() != own.leg.via()
                || vehicle.shares(own.leg)
                || vehicle.is_committed()
                || (entry_m, k) < (vehicle.entry_m(), other)
        });
        let taken = others().any(|(_, other)| other.is_in(own.leg.via()) && !other.shares(own.leg));
        if taken || !is_first || car_claims(car, own.leg) {
            acceleration = acceleration.min(control::follow(speed, entry_m + LINE_SLACK_M, 0.0));
        }
    }
    acceleration
}
