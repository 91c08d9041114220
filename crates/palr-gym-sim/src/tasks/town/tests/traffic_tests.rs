//! The other vehicles: where they drive, and that they hit nobody.

use super::super::traffic::Vehicle;
use super::*;

/// Half the length and width of a hull, as the scene has them.
const HULL_M: [f64; 2] = [1.9, 0.85];

/// Whether two hulls overlap: along none of their axes are they apart.
fn overlap(a: Place, b: Place) -> bool {
    let axes = |place: Place| {
        let (sin, cos) = place.heading_rad.sin_cos();
        [[cos, sin], [-sin, cos]]
    };
    let apart = [b.position_m[0] - a.position_m[0], b.position_m[1] - a.position_m[1]];
    let dot = |u: [f64; 2], v: [f64; 2]| u[0] * v[0] + u[1] * v[1];
    let reach = |place: Place, axis: [f64; 2]| {
        let [along, across] = axes(place);
        HULL_M[0] * dot(along, axis).abs() + HULL_M[1] * dot(across, axis).abs()
    };
    axes(a)
        .into_iter()
        .chain(axes(b))
        .all(|axis| dot(apart, axis).abs() < reach(a, axis) + reach(b, axis))
}

#[test]
fn hulls_overlap_when_they_do() {
    let at = |x, y, heading_rad| Place { position_m: [x, y], heading_rad };
    assert!(overlap(at(0.0, 0.0, 0.0), at(3.7, 0.0, 0.0)));
    assert!(!overlap(at(0.0, 0.0, 0.0), at(3.9, 0.0, 0.0)));
    assert!(!overlap(at(0.0, 0.0, 0.0), at(0.0, 1.8, 0.0)));
    assert!(overlap(at(0.0, 0.0, 0.0), at(2.7, 0.0, 1.57)));
    assert!(!overlap(at(0.0, 0.0, 0.0), at(2.8, 0.0, 1.57)));
}

#[test]
fn vehicles_keep_their_lanes_hit_nobody_and_get_on() {
    let mut env = env(8);
    let (mut waited, mut driven_m, mut steps) = (0, 0.0, 0);
    for seed in 0..12 {
        let mut stuck = [0; traffic::MAX_VEHICLES];
        let watch = |env: &Env, action: &mut [f32]| {
            let state = state(env);
            let places: Vec<Place> = state.traffic().iter().map(Vehicle::place).collect();
            for (k, vehicle) in state.traffic().iter().enumerate() {
                assert!(state.map.is_on_road(places[k].position_m), "seed {seed}: {vehicle:?}");
                assert!(state.map.has(vehicle.leg.from, vehicle.leg.heading));
                assert!(vehicle.speed_mps <= 5.0);
                stuck[k] = if vehicle.speed_mps < 0.05 { stuck[k] + 1 } else { 0 };
                waited += usize::from(stuck[k] == 10);
                // Half a minute would be a jam.
                assert!(stuck[k] < 600, "seed {seed}: {k} stands for ever: {state:?}");
                driven_m += vehicle.speed_mps * 0.05;
                steps += 1;
                for other in k + 1..places.len() {
                    assert!(
                        !overlap(places[k], places[other]),
                        "seed {seed}: {vehicle:?} {:?}",
                        state.traffic()[other]
                    );
                }
            }
            drive(env, action);
        };
        let (_, length, info) = play(&mut env, seed, watch, never);
        assert_eq!((length, info[COLLISION]), (1000, 0.0), "seed {seed}");
    }
    let mean_mps = driven_m / (f64::from(steps) * 0.05);
    assert!(waited > 20 && mean_mps > 1.5, "waited {waited} times, {mean_mps} m/s");
}

#[test]
fn vehicles_stop_behind_a_car_that_stands_on_the_street() {
    let mut env = env(8);
    for seed in 0..12 {
        let (_, steps, info) =
            play(&mut env, seed, |_, action| action.copy_from_slice(&[-1.0, 0.0]), never);
        assert_eq!((steps, info[COLLISION]), (1000, 0.0), "seed {seed}");
    }
}
