//! What an episode remembers beside the physics, in MuJoCo's user data: so it is part of every
//! snapshot, and of nothing that an agent sees. Numbers that no episode wrote lead nowhere bad.

use super::map::{Map, NODES, STREETS};
use super::route::{Leg, MAX_HEADINGS, Route};
use super::traffic::{MAX_VEHICLES, Vehicle};

/// Numbers of a vehicle.
const VEHICLE: usize = 6;
/// Numbers before the vehicles.
const BEFORE: usize = 7 + MAX_HEADINGS;
/// Numbers in the user data.
pub(super) const NUMBERS: usize = BEFORE + MAX_VEHICLES * VEHICLE;

/// An episode's memory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct State {
    pub(super) map: Map,
    pub(super) route: Route,
    /// Where along the route the car is.
    pub(super) progress_m: f64,
    pub(super) goals_reached: f64,
    /// The first `count` are there.
    pub(super) vehicles: [Vehicle; MAX_VEHICLES],
    pub(super) count: usize,
}

/// A number below `end`.
fn index(value: f64, end: usize) -> usize {
    // Casting saturates.
    (value as usize).min(end - 1)
}

impl State {
    /// The map alone.
    pub(super) fn read_map(userdata: &[f64]) -> Map {
        let number = |i: usize| userdata.get(i).copied().unwrap_or(0.0);
        Map { streets: number(0) as u32 & ((1 << STREETS) - 1), rows: number(1) as u64 }
    }

    pub(super) fn read(userdata: &[f64]) -> Self {
        let number = |i: usize| userdata.get(i).copied().unwrap_or(0.0);
        let mut headings = [0; MAX_HEADINGS];
        for (i, heading) in headings.iter_mut().enumerate() {
            *heading = index(number(7 + i), 4);
        }
        let from = index(number(5), NODES);
        let route = Route { from, headings, len: 1 + index(number(6) - 1.0, MAX_HEADINGS) };
        let vehicles = std::array::from_fn(|k| {
            let first = BEFORE + k * VEHICLE;
            Vehicle {
                leg: Leg {
                    from: index(number(first), NODES),
                    heading: index(number(first + 1), 4),
                    out: index(number(first + 2), 4),
                },
                along_m: number(first + 3),
                speed_mps: number(first + 4),
                cruise_mps: number(first + 5),
            }
        });
        Self {
            map: Self::read_map(userdata),
            progress_m: number(2),
            goals_reached: number(3),
            count: index(number(4), MAX_VEHICLES + 1),
            route,
            vehicles,
        }
    }

    pub(super) fn write(&self, userdata: &mut [f64]) {
        let Self { map, route, vehicles, .. } = self;
        let head = [
            f64::from(map.streets),
            map.rows as f64,
            self.progress_m,
            self.goals_reached,
            self.count as f64,
            route.from as f64,
            route.len as f64,
        ];
        let headings = route.headings.iter().map(|&heading| heading as f64);
        let vehicles = vehicles.iter().flat_map(|vehicle| {
            let Leg { from, heading, out } = vehicle.leg;
            [from, heading, out].map(|index| index as f64).into_iter().chain([
                vehicle.along_m,
                vehicle.speed_mps,
                vehicle.cruise_mps,
            ])
        });
        for (slot, value) in
            userdata.iter_mut().zip(head.into_iter().chain(headings).chain(vehicles))
        {
            *slot = value;
        }
    }

    /// The vehicles that are there.
    pub(super) fn traffic(&self) -> &[Vehicle] {
        &self.vehicles[..self.count.min(MAX_VEHICLES)]
    }
}
