//! The lane scene as MJCF, written from a seed.

use std::fmt::Write;

use palr_gym_core::random::Generator;

use super::super::driving::LANE_WIDTH_M;
use super::super::driving::mesh::Mesh;
use super::super::driving::mjcf::{car, drive, hull, line, materials, settings};
use super::USERDATA;
use super::track::{SAMPLES, TRACK};

const SHOULDER_M: f64 = 0.5;
const EDGE_WIDTH_M: f64 = 0.16;
/// Dashes are this long, one every [`DASH_PERIOD_M`].
const DASH_M: f64 = 3.0;
const DASH_PERIOD_M: f64 = 6.0;
/// No markings this near to the crossing.
const CROSSING_RADIUS_M: f64 = 6.0;
/// Layers of the ground, from below: far enough apart that none flickers through another.
const ROAD_HEIGHT_M: f64 = 0.02;
const EDGE_HEIGHT_M: f64 = 0.045;
const DASH_HEIGHT_M: f64 = 0.05;
/// Meshes use every second sample of the track.
const MESH_STRIDE: usize = 2;
const PROPS: usize = 90;
const POSTS_EVERY: usize = 32;

/// The strip along the samples `range` between the offsets `middle_m` ± `width_m` / 2.
fn rows(range: std::ops::RangeInclusive<usize>, middle_m: f64, width_m: f64) -> Vec<[[f64; 2]; 2]> {
    let edges_m = [middle_m + width_m / 2.0, middle_m - width_m / 2.0];
    range.step_by(MESH_STRIDE).map(|i| edges_m.map(|o| TRACK.sample_m(i, o))).collect()
}

/// The scene with the scenery that `seed` draws.
pub(super) fn lane(seed: u64) -> String {
    let mut xml = String::with_capacity(300_000);
    let _ = writeln!(
        xml,
        "<!-- The lane-driving scene: figure eight, two lanes, car, lead car. Written by palr-gym\n     \
         from seed {seed} (crates/palr-gym-sim/examples/write-scenes.rs); do not edit. -->"
    );
    line(&mut xml, 0, "<mujoco model=\"lane\">");
    settings(USERDATA, &mut xml);
    assets(&mut xml);
    line(&mut xml, 2, "<worldbody>");
    world(&mut xml);
    scenery(seed, &mut xml);
    posts(&mut xml);
    lead_car(&mut xml);
    car(&mut xml);
    line(&mut xml, 2, "</worldbody>");
    drive(&mut xml);
    line(&mut xml, 0, "</mujoco>");
    xml
}

fn assets(xml: &mut String) {
    line(xml, 2, "<asset>");
    materials(xml);
    let mut road = Mesh::default();
    road.add_strip(
        &rows(0..=SAMPLES, 0.0, 2.0 * (LANE_WIDTH_M + SHOULDER_M)),
        ROAD_HEIGHT_M,
        |_| true,
    );
    road.write("road", xml);
    let is_marked = |[x, y]: [f64; 2]| x.hypot(y) > CROSSING_RADIUS_M;
    let mut edges = Mesh::default();
    for side in [1.0, -1.0] {
        let rows = rows(0..=SAMPLES, side * LANE_WIDTH_M, EDGE_WIDTH_M);
        edges.add_strip(&rows, EDGE_HEIGHT_M, is_marked);
    }
    edges.write("edges", xml);
    let step_m = TRACK.length_m() / SAMPLES as f64;
    // In whole strides of the mesh.
    let samples =
        |length_m: f64| (length_m / step_m / MESH_STRIDE as f64).round() as usize * MESH_STRIDE;
    let (dash, period) = (samples(DASH_M), samples(DASH_PERIOD_M));
    let mut dashes = Mesh::default();
    for first in (0..SAMPLES - dash).step_by(period) {
        let rows = rows(first..=first + dash, 0.0, EDGE_WIDTH_M);
        dashes.add_strip(&rows, DASH_HEIGHT_M, is_marked);
    }
    dashes.write("dashes", xml);
    line(xml, 2, "</asset>");
}

fn world(xml: &mut String) {
    for text in [
        "<light name=\"sun\" type=\"directional\" dir=\"-0.3 0.2 -1\" diffuse=\"0.7 0.7 0.66\" specular=\"0 0 0\" castshadow=\"false\"/>",
        "<camera name=\"top\" pos=\"0 0 105\" xyaxes=\"1 0 0 0 1 0\" fovy=\"60\"/>",
        "<geom name=\"ground\" type=\"plane\" size=\"140 140 1\" material=\"grass\" contype=\"1\" conaffinity=\"4\" friction=\"1 0.005 0.0001\"/>",
        "<geom name=\"road\" class=\"visual\" type=\"mesh\" mesh=\"road\" material=\"asphalt\"/>",
        "<geom name=\"edges\" class=\"visual\" type=\"mesh\" mesh=\"edges\" material=\"edge\"/>",
        "<geom name=\"dashes\" class=\"visual\" type=\"mesh\" mesh=\"dashes\" material=\"dash\"/>",
    ] {
        line(xml, 4, text);
    }
}

/// Trees and boxes beside the road.
fn scenery(seed: u64, xml: &mut String) {
    let mut generator = Generator::from_seed(seed);
    let mut count = 0;
    while count < PROPS {
        let (x, y) = (generator.uniform(-70.0, 70.0), generator.uniform(-42.0, 42.0));
        let distance_m = TRACK.distance_m([x, y]);
        if distance_m < 8.0 {
            continue;
        }
        count += 1;
        if generator.next_f64() < 0.6 {
            let h = generator.uniform(2.0, 4.0);
            let (red, green) = (generator.uniform(0.1, 0.25), generator.uniform(0.3, 0.5));
            line(
                xml,
                4,
                &format!(
                    "<geom class=\"visual\" type=\"cylinder\" size=\"0.25 {:.2}\" pos=\"{x:.2} {y:.2} {:.2}\" rgba=\"0.35 0.25 0.15 1\"/>",
                    h / 2.0,
                    h / 2.0,
                ),
            );
            line(
                xml,
                4,
                &format!(
                    "<geom class=\"visual\" type=\"ellipsoid\" size=\"{:.2} {:.2} {:.2}\" pos=\"{x:.2} {y:.2} {:.2}\" rgba=\"{red:.2} {green:.2} 0.15 1\"/>",
                    h * 0.45,
                    h * 0.45,
                    h * 0.55,
                    h * 1.2,
                ),
            );
        } else if distance_m > 12.0 {
            let size = [5.0, 5.0, 6.0].map(|most| generator.uniform(2.0, most));
            let color = [0.0; 3].map(|_: f64| generator.uniform(0.4, 0.8));
            line(
                xml,
                4,
                &format!(
                    "<geom class=\"visual\" type=\"box\" size=\"{:.2} {:.2} {:.2}\" pos=\"{x:.2} {y:.2} {:.2}\" rgba=\"{:.2} {:.2} {:.2} 1\"/>",
                    size[0], size[1], size[2], size[2], color[0], color[1], color[2],
                ),
            );
        }
    }
}

/// Posts on both sides, every 8 m: what passes near shows how fast one drives.
fn posts(xml: &mut String) {
    for sample in (0..SAMPLES).step_by(POSTS_EVERY) {
        for side in [1.0, -1.0] {
            let [x, y] = TRACK.sample_m(sample, side * (LANE_WIDTH_M + 1.2));
            if TRACK.distance_m([x, y]) > LANE_WIDTH_M + 0.9 {
                line(
                    xml,
                    4,
                    &format!(
                        "<geom class=\"visual\" type=\"box\" size=\"0.06 0.06 0.45\" pos=\"{x:.2} {y:.2} 0.45\" rgba=\"0.95 0.95 0.95 1\"/>"
                    ),
                );
            }
        }
    }
}

fn lead_car(xml: &mut String) {
    line(xml, 4, "<body name=\"lead\" mocap=\"true\" pos=\"0 200 0\">");
    hull("lead", "0.75 0.1 0.1 1", "contype=\"8\" conaffinity=\"0\"", xml);
    line(xml, 4, "</body>");
}
