//! The centre line: a figure eight, two arcs joined by two straights that cross, smoothed.

use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::LazyLock;

use super::super::driving::{Place, wrap_angle};

/// Points along the line.
pub(super) const SAMPLES: usize = 1024;
/// Centres of the circles are this far left and right of the crossing.
const CIRCLE_CENTER_M: f64 = 30.0;
const CIRCLE_RADIUS_M: f64 = 18.0;
/// Deviation of the Gaussian that smooths the joints of arcs and straights.
const SMOOTHING_M: f64 = 2.5;
/// A car is looked for this far before and behind where it was.
const SEARCH_M: f64 = 8.0;

/// A closed line, sampled evenly.
#[derive(Debug)]
pub(super) struct Track {
    points: Vec<[f64; 2]>,
    tangents: Vec<[f64; 2]>,
    /// Arc length up to each point.
    arc_m: Vec<f64>,
    curvature_per_m: Vec<f64>,
    length_m: f64,
}

/// A point as seen from a track.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Projection {
    /// Arc length of the nearest place, in [0, length).
    pub(super) progress_m: f64,
    /// Distance from the line, positive to the left.
    pub(super) offset_m: f64,
    /// Direction of travel there.
    pub(super) tangent: [f64; 2],
    /// Positive in a left turn.
    pub(super) curvature_per_m: f64,
}

/// The lane scene's track.
pub(super) static TRACK: LazyLock<Track> = LazyLock::new(Track::figure_eight);

impl Track {
    fn figure_eight() -> Self {
        let angle = (CIRCLE_RADIUS_M / CIRCLE_CENTER_M).asin();
        let half_m = (CIRCLE_CENTER_M * CIRCLE_CENTER_M - CIRCLE_RADIUS_M * CIRCLE_RADIUS_M).sqrt();
        let (end_x, end_y) = (half_m * angle.cos(), half_m * angle.sin());
        let (straight, arc) = (400, 800);
        let mut corners = Vec::with_capacity(2 * (straight + arc));
        let fraction = |k: usize, of: usize| k as f64 / of as f64;
        let line = |from: [f64; 2], to: [f64; 2]| {
            (0..straight).map(move |k| {
                let part = fraction(k, straight);
                [from[0] + part * (to[0] - from[0]), from[1] + part * (to[1] - from[1])]
            })
        };
        // From the lower left over the crossing, clockwise around the right circle, back over the
        // crossing, counter-clockwise around the left one.
        let sweep = PI + 2.0 * angle;
        corners.extend(line([-end_x, -end_y], [end_x, end_y]));
        corners.extend((0..arc).map(|k| {
            let at = FRAC_PI_2 + angle - fraction(k, arc) * sweep;
            [CIRCLE_CENTER_M + CIRCLE_RADIUS_M * at.cos(), CIRCLE_RADIUS_M * at.sin()]
        }));
        corners.extend(line([end_x, -end_y], [-end_x, end_y]));
        corners.extend((0..arc).map(|k| {
            let at = FRAC_PI_2 - angle + fraction(k, arc) * sweep;
            [-CIRCLE_CENTER_M + CIRCLE_RADIUS_M * at.cos(), CIRCLE_RADIUS_M * at.sin()]
        }));
        Self::new(resample(&smooth(&resample(&corners))))
    }

    fn new(points: Vec<[f64; 2]>) -> Self {
        let n = points.len();
        let tangents: Vec<[f64; 2]> = (0..n)
            .map(|i| {
                let (after, before) = (points[(i + 1) % n], points[(i + n - 1) % n]);
                let (x, y) = (after[0] - before[0], after[1] - before[1]);
                let length = x.hypot(y);
                [x / length, y / length]
            })
            .collect();
        let steps: Vec<f64> = (0..n).map(|i| distance_m(points[i], points[(i + 1) % n])).collect();
        let mut length_m = 0.0;
        let arc_m = steps
            .iter()
            .map(|step| {
                let here = length_m;
                length_m += step;
                here
            })
            .collect();
        let heading = |i: usize| tangents[i][1].atan2(tangents[i][0]);
        let curvature_per_m = (0..n)
            .map(|i| {
                let turn = heading((i + 1) % n) - heading((i + n - 1) % n);
                wrap_angle(turn) / (steps[i] + steps[(i + n - 1) % n])
            })
            .collect();
        Self { points, tangents, arc_m, curvature_per_m, length_m }
    }

    /// Once around.
    pub(super) fn length_m(&self) -> f64 {
        self.length_m
    }

    /// A sample moved `offset_m` to the left.
    pub(super) fn sample_m(&self, index: usize, offset_m: f64) -> [f64; 2] {
        let (point, tangent) = (self.points[index % SAMPLES], self.tangents[index % SAMPLES]);
        [point[0] - offset_m * tangent[1], point[1] + offset_m * tangent[0]]
    }

    /// How far a point is from the line, wherever along it.
    pub(super) fn distance_m(&self, point: [f64; 2]) -> f64 {
        self.points.iter().map(|&own| distance_m(own, point)).fold(f64::INFINITY, f64::min)
    }

    fn index(&self, progress_m: f64) -> (usize, f64) {
        let at = progress_m.rem_euclid(self.length_m) / self.length_m * SAMPLES as f64;
        // Casting saturates, so that no number leads astray.
        (at as usize % SAMPLES, at.fract())
    }

    /// The place `progress_m` along the line and `offset_m` to its left.
    pub(super) fn place(&self, progress_m: f64, offset_m: f64) -> Place {
        let (i, part) = self.index(progress_m);
        let blend = |a: [f64; 2], b: [f64; 2]| {
            [(1.0 - part) * a[0] + part * b[0], (1.0 - part) * a[1] + part * b[1]]
        };
        let next = (i + 1) % SAMPLES;
        let tangent = blend(self.tangents[i], self.tangents[next]);
        Place {
            position_m: blend(self.sample_m(i, offset_m), self.sample_m(next, offset_m)),
            heading_rad: tangent[1].atan2(tangent[0]),
        }
    }

    /// Where `point` is, given roughly how far along: at the crossing the line alone cannot tell.
    pub(super) fn project(&self, point: [f64; 2], near_progress_m: f64) -> Projection {
        let (middle, _) = self.index(near_progress_m);
        let reach = (SEARCH_M / self.length_m * SAMPLES as f64) as usize + 1;
        let first = middle + SAMPLES - reach;
        let square = |i: usize| {
            let own = self.points[i % SAMPLES];
            let (x, y) = (own[0] - point[0], own[1] - point[1]);
            x * x + y * y
        };
        let mut nearest = (first % SAMPLES, square(first));
        for i in first + 1..=middle + SAMPLES + reach {
            let found = square(i);
            if found < nearest.1 {
                nearest = (i % SAMPLES, found);
            }
        }
        let i = nearest.0;
        let (own, tangent) = (self.points[i], self.tangents[i]);
        let (x, y) = (point[0] - own[0], point[1] - own[1]);
        Projection {
            progress_m: (self.arc_m[i] + x * tangent[0] + y * tangent[1]).rem_euclid(self.length_m),
            offset_m: y * tangent[0] - x * tangent[1],
            tangent,
            curvature_per_m: self.curvature_per_m[i],
        }
    }

    /// How far `ahead_m` is in front of `behind_m`, in [-length / 2, length / 2).
    pub(super) fn gap_m(&self, ahead_m: f64, behind_m: f64) -> f64 {
        let half = self.length_m / 2.0;
        (ahead_m - behind_m + half).rem_euclid(self.length_m) - half
    }
}

fn distance_m(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// The closed line through `corners` as [`SAMPLES`] points at equal distances.
fn resample(corners: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let n = corners.len();
    let mut arc_m = vec![0.0];
    for i in 0..n {
        arc_m.push(arc_m[i] + distance_m(corners[i], corners[(i + 1) % n]));
    }
    let mut i = 0;
    (0..SAMPLES)
        .map(|k| {
            let at = arc_m[n] * k as f64 / SAMPLES as f64;
            while arc_m[i + 1] <= at {
                i += 1;
            }
            let part = (at - arc_m[i]) / (arc_m[i + 1] - arc_m[i]);
            let (a, b) = (corners[i], corners[(i + 1) % n]);
            [a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1])]
        })
        .collect()
}

/// Every point becomes the Gaussian mean of its neighbours.
fn smooth(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let n = points.len();
    let length: f64 = (0..n).map(|i| distance_m(points[i], points[(i + 1) % n])).sum();
    let step_m = length / n as f64;
    let reach = (4.0 * SMOOTHING_M / step_m) as usize;
    let weight = |k: usize| (-0.5 * (k as f64 * step_m / SMOOTHING_M).powi(2)).exp();
    let total: f64 = 1.0 + 2.0 * (1..=reach).map(weight).sum::<f64>();
    (0..n)
        .map(|i| {
            let mut mean = points[i];
            for k in 1..=reach {
                let (a, b) = (points[(i + k) % n], points[(i + n - k) % n]);
                mean[0] += weight(k) * (a[0] + b[0]);
                mean[1] += weight(k) * (a[1] + b[1]);
            }
            [mean[0] / total, mean[1] / total]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The design's figures: length and greatest curvature.
    #[test]
    fn the_track_is_as_long_and_as_curved_as_designed() {
        assert!((TRACK.length_m() - 253.9).abs() < 0.1, "{}", TRACK.length_m());
        let sharpest = TRACK.curvature_per_m.iter().fold(0.0_f64, |most, k| most.max(k.abs()));
        assert!((0.054..0.0565).contains(&sharpest), "{sharpest}");
        // One turn left and one right: nothing remains.
        let step = TRACK.length_m() / SAMPLES as f64;
        let turned: f64 = TRACK.curvature_per_m.iter().map(|k| k * step).sum();
        assert!(turned.abs() < 1e-2, "{turned}");
    }

    #[test]
    fn a_place_projects_to_itself_at_the_crossing_too() {
        for k in 0..500 {
            let progress_m = k as f64 / 500.0 * TRACK.length_m();
            for offset_m in [-1.75, 0.0, 1.9] {
                let place = TRACK.place(progress_m, offset_m);
                let seen = TRACK.project(place.position_m, progress_m + 3.0);
                assert!(TRACK.gap_m(seen.progress_m, progress_m).abs() < 0.05, "{progress_m}");
                assert!((seen.offset_m - offset_m).abs() < 0.01, "{progress_m} {offset_m}");
            }
        }
    }

    #[test]
    fn no_number_breaks_it() {
        for value in [f64::NAN, f64::INFINITY, -1e300, -0.0] {
            let _ = TRACK.place(value, 0.0);
            let _ = TRACK.project([value, value], value);
        }
    }
}
