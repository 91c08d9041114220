//! The lane scene as MJCF, written from a seed.

use std::fmt::Write;

use palr_gym_core::random::Generator;

use super::track::{SAMPLES, TRACK};
use super::{
    CAR_HALF_LENGTH_M, FRAME_STEP_S, LANE_WIDTH_M, STEERING_LIMIT_RAD, USERDATA, WHEEL_RADIUS_M,
    WHEELBASE_M,
};

const AXLE_TRACK_M: f64 = 1.6;
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

/// A triangle mesh.
#[derive(Default)]
struct Mesh {
    vertices: Vec<[f64; 3]>,
    faces: Vec<[usize; 3]>,
}

impl Mesh {
    /// Adds a strip along the samples `range` between the offsets `middle_m` ± `width_m` / 2.
    fn add_strip(
        &mut self,
        range: std::ops::RangeInclusive<usize>,
        middle_m: f64,
        width_m: f64,
        height_m: f64,
        keeps: impl Fn([f64; 2]) -> bool,
    ) {
        let rows: Vec<[[f64; 2]; 2]> = range
            .step_by(MESH_STRIDE)
            .map(|i| {
                [middle_m + width_m / 2.0, middle_m - width_m / 2.0].map(|o| TRACK.sample_m(i, o))
            })
            .collect();
        // Neighbouring pieces share the vertices between them.
        let mut shared = None;
        for pair in rows.windows(2) {
            let [[a, b], [c, d]] = [pair[0], pair[1]];
            if !keeps([(a[0] + d[0]) / 2.0, (a[1] + d[1]) / 2.0]) {
                shared = None;
                continue;
            }
            let first = shared.unwrap_or_else(|| self.add_row(a, b, height_m));
            let second = self.add_row(c, d, height_m);
            self.faces.extend([[first, first + 1, second], [first + 1, second + 1, second]]);
            shared = Some(second);
        }
    }

    fn add_row(&mut self, left: [f64; 2], right: [f64; 2], height_m: f64) -> usize {
        self.vertices.extend([left, right].map(|[x, y]| [x, y, height_m]));
        self.vertices.len() - 2
    }

    fn write(&self, name: &str, xml: &mut String) {
        let vertices: Vec<String> =
            self.vertices.iter().map(|[x, y, z]| format!("{x:.3} {y:.3} {z}")).collect();
        let texture: Vec<String> = self
            .vertices
            .iter()
            .map(|[x, y, _]| format!("{:.3} {:.3}", x / 8.0, y / 8.0))
            .collect();
        let faces: Vec<String> =
            self.faces.iter().map(|[a, b, c]| format!("{a} {b} {c}")).collect();
        line(xml, 4, &format!("<mesh name=\"{name}\" inertia=\"shell\""));
        line(xml, 10, &format!("vertex=\"{}\"", wrapped(&vertices)));
        line(xml, 10, &format!("texcoord=\"{}\"", wrapped(&texture)));
        line(xml, 10, &format!("face=\"{}\"/>", wrapped(&faces)));
    }
}

/// Eight items a line.
fn wrapped(items: &[String]) -> String {
    let lines: Vec<String> = items.chunks(8).map(|chunk| chunk.join(" ")).collect();
    lines.join("\n            ")
}

fn line(xml: &mut String, indent: usize, text: &str) {
    // Writing to a string cannot fail.
    let _ = writeln!(xml, "{:indent$}{text}", "");
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
    settings(&mut xml);
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

fn settings(xml: &mut String) {
    for text in [
        "<compiler angle=\"radian\" autolimits=\"true\"/>".to_owned(),
        format!(
            "<option timestep=\"{FRAME_STEP_S}\" integrator=\"implicitfast\" cone=\"elliptic\" impratio=\"5\"/>"
        ),
        format!("<size nuserdata=\"{USERDATA}\"/>"),
        "<statistic extent=\"20\" center=\"0 0 0\"/>".to_owned(),
    ] {
        line(xml, 2, &text);
    }
    line(xml, 2, "<visual>");
    for text in [
        "<global offwidth=\"640\" offheight=\"640\"/>",
        "<quality shadowsize=\"0\" offsamples=\"0\" numslices=\"8\" numstacks=\"5\" numquads=\"1\"/>",
        "<map znear=\"0.02\" zfar=\"12\" fogstart=\"3\" fogend=\"10\"/>",
        "<headlight ambient=\"0.35 0.35 0.35\" diffuse=\"0.15 0.15 0.15\" specular=\"0 0 0\"/>",
        "<rgba haze=\"0.75 0.82 0.9 1\" fog=\"0.75 0.82 0.9 1\"/>",
    ] {
        line(xml, 4, text);
    }
    line(xml, 2, "</visual>");
    line(xml, 2, "<default>");
    line(xml, 4, "<default class=\"visual\">");
    line(xml, 6, "<geom contype=\"0\" conaffinity=\"0\" mass=\"0\"/>");
    line(xml, 4, "</default>");
    line(xml, 2, "</default>");
}

fn assets(xml: &mut String) {
    line(xml, 2, "<asset>");
    for text in [
        "<texture name=\"sky\" type=\"skybox\" builtin=\"gradient\" rgb1=\"0.35 0.55 0.85\" rgb2=\"0.85 0.9 0.95\" width=\"128\" height=\"768\"/>",
        "<texture name=\"grass\" type=\"2d\" builtin=\"flat\" mark=\"random\" random=\"0.25\" markrgb=\"0.28 0.42 0.2\" rgb1=\"0.2 0.36 0.15\" rgb2=\"0.2 0.36 0.15\" width=\"128\" height=\"128\"/>",
        "<texture name=\"asphalt\" type=\"2d\" builtin=\"flat\" mark=\"random\" random=\"0.2\" markrgb=\"0.36 0.36 0.37\" rgb1=\"0.28 0.28 0.3\" rgb2=\"0.28 0.28 0.3\" width=\"128\" height=\"128\"/>",
        "<material name=\"grass\" texture=\"grass\" texrepeat=\"0.12 0.12\" texuniform=\"true\" specular=\"0\"/>",
        "<material name=\"asphalt\" texture=\"asphalt\" specular=\"0\"/>",
        "<material name=\"edge\" rgba=\"0.92 0.92 0.9 1\" specular=\"0\"/>",
        "<material name=\"dash\" rgba=\"0.9 0.72 0.15 1\" specular=\"0\"/>",
        "<material name=\"tail_light\" rgba=\"0.5 0.05 0.05 1\" emission=\"0\"/>",
    ] {
        line(xml, 4, text);
    }
    let mut road = Mesh::default();
    road.add_strip(0..=SAMPLES, 0.0, 2.0 * (LANE_WIDTH_M + SHOULDER_M), ROAD_HEIGHT_M, |_| true);
    road.write("road", xml);
    let is_marked = |[x, y]: [f64; 2]| x.hypot(y) > CROSSING_RADIUS_M;
    let mut edges = Mesh::default();
    for side in [1.0, -1.0] {
        edges.add_strip(0..=SAMPLES, side * LANE_WIDTH_M, EDGE_WIDTH_M, EDGE_HEIGHT_M, is_marked);
    }
    edges.write("edges", xml);
    let step_m = TRACK.length_m() / SAMPLES as f64;
    // In whole strides of the mesh.
    let samples =
        |length_m: f64| (length_m / step_m / MESH_STRIDE as f64).round() as usize * MESH_STRIDE;
    let (dash, period) = (samples(DASH_M), samples(DASH_PERIOD_M));
    let mut dashes = Mesh::default();
    for first in (0..SAMPLES - dash).step_by(period) {
        dashes.add_strip(first..=first + dash, 0.0, EDGE_WIDTH_M, DASH_HEIGHT_M, is_marked);
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

/// Hull, cabin and tail lights.
fn hull(name: &str, color: &str, attributes: &str, xml: &mut String) {
    line(
        xml,
        6,
        &format!(
            "<geom name=\"{name}_hull\" type=\"box\" size=\"{CAR_HALF_LENGTH_M} 0.85 0.32\" pos=\"0 0 0.62\" rgba=\"{color}\" {attributes}/>"
        ),
    );
    line(
        xml,
        6,
        "<geom class=\"visual\" type=\"box\" size=\"1 0.75 0.28\" pos=\"-0.2 0 1.2\" rgba=\"0.1 0.12 0.15 1\"/>",
    );
    for y in ["0.55", "-0.55"] {
        line(
            xml,
            6,
            &format!(
                "<geom class=\"visual\" type=\"box\" size=\"0.03 0.22 0.1\" pos=\"-1.92 {y} 0.75\" material=\"tail_light\"/>"
            ),
        );
    }
}

fn lead_car(xml: &mut String) {
    line(xml, 4, "<body name=\"lead\" mocap=\"true\" pos=\"0 200 0\">");
    hull("lead", "0.75 0.1 0.1 1", "contype=\"8\" conaffinity=\"0\"", xml);
    line(xml, 4, "</body>");
}

fn car(xml: &mut String) {
    line(xml, 4, "<body name=\"car\" pos=\"0 0 0.02\">");
    line(xml, 6, "<freejoint name=\"root\"/>");
    hull("car", "0.85 0.85 0.85 1", "mass=\"900\" contype=\"0\" conaffinity=\"8\"", xml);
    for text in [
        "<camera name=\"driver\" pos=\"1.6 0 1.7\" xyaxes=\"0 -1 0 0 0 1\" fovy=\"48\"/>",
        "<camera name=\"chase\" pos=\"-7 0 3.2\" xyaxes=\"0 -1 0 0.3 0 1\" fovy=\"55\"/>",
        "<body name=\"column\" pos=\"0 0 0.6\">",
        "  <joint name=\"steer\" type=\"hinge\" axis=\"0 0 1\" range=\"-0.7 0.7\" damping=\"60\" armature=\"4\"/>",
        "  <inertial pos=\"0 0 0\" mass=\"2\" diaginertia=\"0.05 0.05 0.05\"/>",
        "</body>",
    ] {
        line(xml, 6, text);
    }
    let (front, side) = (WHEELBASE_M / 2.0, AXLE_TRACK_M / 2.0);
    for (name, x, y, steers) in [
        ("fl", front, side, true),
        ("fr", front, -side, true),
        ("rl", -front, side, false),
        ("rr", -front, -side, false),
    ] {
        line(xml, 6, &format!("<body name=\"{name}\" pos=\"{x} {y} {WHEEL_RADIUS_M}\">"));
        line(
            xml,
            8,
            &format!(
                "<joint name=\"{name}_suspension\" type=\"slide\" axis=\"0 0 1\" range=\"-0.15 0.15\" stiffness=\"45000\" damping=\"3500\" springref=\"-0.055\"/>"
            ),
        );
        if steers {
            line(
                xml,
                8,
                &format!(
                    "<joint name=\"{name}_steer\" type=\"hinge\" axis=\"0 0 1\" range=\"-0.75 0.75\" damping=\"30\" armature=\"2\"/>"
                ),
            );
        }
        line(xml, 8, "<inertial pos=\"0 0 0\" mass=\"12\" diaginertia=\"0.4 0.4 0.4\"/>");
        line(xml, 8, &format!("<body name=\"{name}_wheel\">"));
        line(
            xml,
            10,
            &format!(
                "<joint name=\"{name}_roll\" type=\"hinge\" axis=\"0 1 0\" damping=\"0.5\" armature=\"1\"/>"
            ),
        );
        // A sphere rolls over triangles' edges and flat ground alike; the cylinder is for the eye.
        line(
            xml,
            10,
            &format!(
                "<geom type=\"sphere\" size=\"{WHEEL_RADIUS_M}\" mass=\"18\" rgba=\"0 0 0 0\" contype=\"4\" conaffinity=\"1\" condim=\"3\" friction=\"1 0.005 0.0001\" priority=\"1\"/>"
            ),
        );
        line(
            xml,
            10,
            &format!(
                "<geom class=\"visual\" type=\"cylinder\" size=\"{WHEEL_RADIUS_M} 0.1\" euler=\"1.5708 0 0\" rgba=\"0.08 0.08 0.08 1\"/>"
            ),
        );
        line(xml, 8, "</body>");
        line(xml, 6, "</body>");
    }
    line(xml, 4, "</body>");
}

/// Ackermann steering, drive train and brakes.
fn drive(xml: &mut String) {
    // To first order the inner wheel turns by a (1 + a T / 2 L), the outer by a (1 - a T / 2 L).
    let ackermann = AXLE_TRACK_M / (2.0 * WHEELBASE_M);
    line(xml, 2, "<equality>");
    for (name, sign) in [("fl", 1.0), ("fr", -1.0)] {
        line(
            xml,
            4,
            &format!(
                "<joint joint1=\"{name}_steer\" joint2=\"steer\" polycoef=\"0 1 {:.4} 0 0\" solref=\"0.02 1\"/>",
                sign * ackermann,
            ),
        );
    }
    line(xml, 2, "</equality>");
    line(xml, 2, "<actuator>");
    for name in ["rl", "rr"] {
        line(
            xml,
            4,
            &format!(
                "<general name=\"throttle_{name}\" joint=\"{name}_roll\" dyntype=\"filterexact\" dynprm=\"0.25\" gainprm=\"520\" biastype=\"affine\" biasprm=\"0 0 -12\" ctrlrange=\"0 1\"/>"
            ),
        );
    }
    for name in ["fl", "fr", "rl", "rr"] {
        line(
            xml,
            4,
            &format!(
                "<damper name=\"brake_{name}\" joint=\"{name}_roll\" kv=\"100\" ctrlrange=\"0 1\" forcerange=\"-500 500\"/>"
            ),
        );
    }
    line(
        xml,
        4,
        &format!(
            "<general name=\"steer\" joint=\"steer\" dyntype=\"filterexact\" dynprm=\"0.2\" gainprm=\"3000\" biastype=\"affine\" biasprm=\"0 -3000 -250\" ctrlrange=\"-{STEERING_LIMIT_RAD} {STEERING_LIMIT_RAD}\"/>"
        ),
    );
    line(xml, 2, "</actuator>");
}
