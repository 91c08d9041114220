//! The town scene as MJCF: the pieces of every map, and which of them other viewers show.

use std::f64::consts::FRAC_PI_2;
use std::fmt::Write;

use palr_gym_core::random::Generator;

use super::super::driving::mesh::Mesh;
use super::super::driving::mjcf::{car, drive, hull, line, materials, settings};
use super::super::driving::{LANE_WIDTH_M, Place};
use super::map::{HEADINGS, Map, NODES, ROWS, STREETS, direction, ends, node_m, street};
use super::route::STREET_M;
use super::traffic::MAX_VEHICLES;
use super::{BLOCK_M, JUNCTION_M, USERDATA, parked, pieces};
use crate::render::Pieces;

const SHOULDER_M: f64 = 0.5;
/// From a street's middle to its kerb.
const KERB_M: f64 = LANE_WIDTH_M + SHOULDER_M;
const WALK_M: f64 = 2.0;
const WALK_HEIGHT_M: f64 = 0.15;
const EDGE_WIDTH_M: f64 = 0.16;
const STOP_LINE_M: f64 = 0.4;
const DASH_M: f64 = 2.0;
const DASH_PERIOD_M: f64 = 4.0;
/// Layers of the ground, from below: far enough apart that none flickers through another.
const ROAD_HEIGHT_M: f64 = 0.02;
const EDGE_HEIGHT_M: f64 = 0.045;
const DASH_HEIGHT_M: f64 = 0.05;
/// Pieces of a quarter circle.
const ARC_PIECES: usize = 8;
/// Buildings stand in a strip this far from their street's middle.
const BUILDINGS_M: (f64, f64) = (7.0, 14.0);
/// Along their street, between these distances from its ends' junctions: the corners of a block
/// belong to the streets that run east.
const ALONG_M: [(f64, f64); 2] = [(7.5, BLOCK_M - 7.5), (15.0, BLOCK_M - 15.0)];
const COLORS: [&str; MAX_VEHICLES] = [
    "0.75 0.1 0.1 1",
    "0.15 0.25 0.6 1",
    "0.9 0.75 0.15 1",
    "0.2 0.45 0.25 1",
    "0.85 0.4 0.1 1",
    "0.35 0.35 0.38 1",
    "0.5 0.2 0.5 1",
    "0.9 0.9 0.9 1",
];

/// A junction's form, with the arms of the one that others are turned from.
const FORMS: [(&str, usize); 4] =
    [("bend", 0b0011), ("straight", 0b0101), ("tee", 0b0111), ("cross", 0b1111)];

/// A part of a scene that is being written.
struct Writer<'a> {
    xml: &'a mut String,
    /// What is shown by viewers that know nothing of pieces.
    shown: Pieces,
}

impl Writer<'_> {
    /// Writes a geom that belongs to a piece.
    fn geom(&mut self, piece: usize, text: &str) {
        let group = if self.shown.contains(piece) { "" } else { " group=\"3\"" };
        line(self.xml, 4, &format!("<geom class=\"visual\" {text} user=\"{piece}\"{group}/>"));
    }
}

/// The scene, showing `map`. `seed` is what the map is drawn from.
pub(super) fn town(seed: u64, map: &Map) -> String {
    let mut xml = String::with_capacity(200_000);
    let _ = writeln!(
        xml,
        "<!-- The town: streets, buildings, car, other vehicles. Written by palr-gym (crates/palr-gym-sim/\n     \
         examples/write-scenes.rs); do not edit. Holds the pieces of every map; those that the map of\n     \
         seed {seed} lacks are in group 3, which viewers hide. -->"
    );
    line(&mut xml, 0, "<mujoco model=\"town\">");
    settings(USERDATA, &mut xml);
    assets(&mut xml);
    line(&mut xml, 2, "<worldbody>");
    for text in [
        "<light name=\"sun\" type=\"directional\" dir=\"-0.3 0.2 -1\" diffuse=\"0.7 0.7 0.66\" specular=\"0 0 0\" castshadow=\"false\"/>",
        "<camera name=\"top\" pos=\"0 0 150\" xyaxes=\"1 0 0 0 1 0\" fovy=\"60\"/>",
        "<geom name=\"ground\" type=\"plane\" size=\"140 140 1\" material=\"grass\" contype=\"1\" conaffinity=\"4\" friction=\"1 0.005 0.0001\" user=\"0\"/>",
    ] {
        line(&mut xml, 4, text);
    }
    let mut writer = Writer { xml: &mut xml, shown: pieces::of_map(map) };
    streets(&mut writer);
    junctions(&mut writer);
    // Always the same, so that a building is what it is in every map.
    buildings(&mut Generator::from_seed(0), &mut writer);
    vehicles(&mut xml);
    car(&mut xml);
    line(&mut xml, 2, "</worldbody>");
    drive(&mut xml);
    line(&mut xml, 0, "</mujoco>");
    xml
}

/// Points on the x axis, and what is `aside_m` of them on both sides.
fn straight(from_m: f64, to_m: f64, middle_m: f64, width_m: f64) -> [[[f64; 2]; 2]; 2] {
    [from_m, to_m].map(|x| [[x, middle_m + width_m / 2.0], [x, middle_m - width_m / 2.0]])
}

/// A quarter circle about the corner between two arms, from the first to the second: rows between
/// two radii.
fn corner(first: usize, inner_m: f64, outer_m: f64) -> Vec<[[f64; 2]; 2]> {
    let ([ax, ay], [bx, by]) = (direction(first), direction(first + 1));
    let middle = [JUNCTION_M * (ax + bx), JUNCTION_M * (ay + by)];
    (0..=ARC_PIECES)
        .map(|i| {
            let (sin, cos) = (FRAC_PI_2 * i as f64 / ARC_PIECES as f64).sin_cos();
            let [x, y] = [-(bx * cos + ax * sin), -(by * cos + ay * sin)];
            // On the way from the first arm to the second the corner is to the right.
            [outer_m, inner_m].map(|radius| [middle[0] + radius * x, middle[1] + radius * y])
        })
        .collect()
}

fn turned([x, y]: [f64; 2], heading: usize) -> [f64; 2] {
    let [ux, uy] = direction(heading);
    [x * ux - y * uy, x * uy + y * ux]
}

fn assets(xml: &mut String) {
    line(xml, 2, "<asset>");
    materials(xml);
    line(xml, 4, "<material name=\"walk\" rgba=\"0.62 0.6 0.57 1\" specular=\"0\"/>");
    let half_m = STREET_M / 2.0;
    let mut road = Mesh::default();
    road.add_strip(&straight(-half_m, half_m, 0.0, 2.0 * KERB_M), ROAD_HEIGHT_M, |_| true);
    road.write("street_road", xml);
    let (mut edges, mut walks) = (Mesh::default(), Mesh::default());
    for side in [1.0, -1.0] {
        let rows = straight(-half_m, half_m, side * LANE_WIDTH_M, EDGE_WIDTH_M);
        edges.add_strip(&rows, EDGE_HEIGHT_M, |_| true);
        let rows = straight(-half_m, half_m, side * (KERB_M + WALK_M / 2.0), WALK_M);
        walks.add_kerb(&rows, WALK_HEIGHT_M);
    }
    edges.write("street_edges", xml);
    walks.write("street_walks", xml);
    let mut dashes = Mesh::default();
    for i in 0..(STREET_M / DASH_PERIOD_M) as usize {
        let from_m = -half_m + (DASH_PERIOD_M - DASH_M) / 2.0 + i as f64 * DASH_PERIOD_M;
        let rows = straight(from_m, from_m + DASH_M, 0.0, EDGE_WIDTH_M);
        dashes.add_strip(&rows, DASH_HEIGHT_M, |_| true);
    }
    dashes.write("street_dashes", xml);
    for (name, arms) in FORMS {
        junction_meshes(name, arms, xml);
    }
    line(xml, 2, "</asset>");
}

/// Road, kerbs and lines of a junction.
fn junction_meshes(name: &str, arms: usize, xml: &mut String) {
    let has = |heading: usize| arms >> (heading % 4) & 1 == 1;
    let is_bend = name == "bend";
    let (mut road, mut walks) = (Mesh::default(), Mesh::default());
    let (mut edges, mut dashes) = (Mesh::default(), Mesh::default());
    if is_bend {
        road.add_strip(&corner(0, JUNCTION_M - KERB_M, JUNCTION_M + KERB_M), ROAD_HEIGHT_M, |_| {
            true
        });
    } else {
        road.add_star(&outline(arms), ROAD_HEIGHT_M);
    }
    for first in HEADINGS {
        if has(first) && has(first + 1) {
            let inner_m = JUNCTION_M - KERB_M;
            walks.add_kerb(&corner(first, inner_m - WALK_M, inner_m), WALK_HEIGHT_M);
            edge_arc(first, JUNCTION_M - LANE_WIDTH_M, &mut edges);
        }
    }
    if is_bend {
        let outer_m = JUNCTION_M + KERB_M;
        walks.add_kerb(&corner(0, outer_m, outer_m + WALK_M), WALK_HEIGHT_M);
        edge_arc(0, JUNCTION_M + LANE_WIDTH_M, &mut edges);
        let half_m = EDGE_WIDTH_M / 2.0;
        for pair in corner(0, JUNCTION_M - half_m, JUNCTION_M + half_m).windows(2).step_by(2) {
            dashes.add_strip(pair, DASH_HEIGHT_M, |_| true);
        }
    }
    for heading in HEADINGS {
        let turn = |rows: [[[f64; 2]; 2]; 2]| rows.map(|row| row.map(|at| turned(at, heading)));
        if !has(heading) && !is_bend {
            // Along the side without a street; x is the way from the middle to it.
            let across = |x_m: f64, width_m: f64| {
                let [near, far] = [x_m - width_m / 2.0, x_m + width_m / 2.0];
                turn([-JUNCTION_M, JUNCTION_M].map(|y| [[near, y], [far, y]]))
            };
            walks.add_kerb(&across(KERB_M + WALK_M / 2.0, WALK_M), WALK_HEIGHT_M);
            edges.add_strip(&across(LANE_WIDTH_M, EDGE_WIDTH_M), EDGE_HEIGHT_M, |_| true);
        }
        if has(heading) && arms.count_ones() > 2 {
            // Where the lane that comes from there must wait: on its right, seen from outside.
            let [near, far] = [JUNCTION_M - STOP_LINE_M, JUNCTION_M];
            let rows = turn([0.0, LANE_WIDTH_M].map(|y| [[near, y], [far, y]]));
            edges.add_strip(&rows, EDGE_HEIGHT_M, |_| true);
        }
    }
    if name == "straight" {
        for i in 0..(2.0 * JUNCTION_M / DASH_PERIOD_M) as usize {
            let from_m = -JUNCTION_M + (DASH_PERIOD_M - DASH_M) / 2.0 + i as f64 * DASH_PERIOD_M;
            let rows = straight(from_m, from_m + DASH_M, 0.0, EDGE_WIDTH_M);
            dashes.add_strip(&rows, DASH_HEIGHT_M, |_| true);
        }
    }
    road.write(&format!("{name}_road"), xml);
    walks.write(&format!("{name}_walks"), xml);
    edges.write(&format!("{name}_edges"), xml);
    if has_dashes(arms) {
        dashes.write(&format!("{name}_dashes"), xml);
    }
}

/// Only where nobody has to wait does the middle line go on.
fn has_dashes(arms: usize) -> bool {
    arms.count_ones() == 2
}

fn edge_arc(first: usize, radius_m: f64, edges: &mut Mesh) {
    let half_m = EDGE_WIDTH_M / 2.0;
    edges.add_strip(&corner(first, radius_m - half_m, radius_m + half_m), EDGE_HEIGHT_M, |_| true);
}

/// The asphalt of a junction, corner by corner.
fn outline(arms: usize) -> Vec<[f64; 2]> {
    let has = |heading: usize| arms >> (heading % 4) & 1 == 1;
    let mut corners = Vec::new();
    for first in HEADINGS {
        let out_m = if has(first) { JUNCTION_M } else { KERB_M };
        corners.extend([-KERB_M, KERB_M].map(|y| turned([out_m, y], first)));
        if has(first) && has(first + 1) {
            let inner_m = JUNCTION_M - KERB_M;
            let rows = corner(first, inner_m, inner_m);
            // Without the ends, which belong to the arms.
            corners.extend(rows[1..rows.len() - 1].iter().map(|row| row[0]));
        }
    }
    corners
}

fn mesh_geom(mesh: &str, material: &str, [x, y]: [f64; 2], heading: usize) -> String {
    let turn = heading as f64 * FRAC_PI_2;
    format!(
        "type=\"mesh\" mesh=\"{mesh}\" material=\"{material}\" pos=\"{x} {y} 0\" euler=\"0 0 {turn:.6}\""
    )
}

fn streets(writer: &mut Writer<'_>) {
    for index in 0..STREETS {
        let (node, heading) = ends(index);
        let ([x, y], [ux, uy]) = (node_m(node), direction(heading));
        let middle = [x + BLOCK_M / 2.0 * ux, y + BLOCK_M / 2.0 * uy];
        for (mesh, material) in [
            ("street_road", "asphalt"),
            ("street_edges", "edge"),
            ("street_dashes", "dash"),
            ("street_walks", "walk"),
        ] {
            writer.geom(pieces::street(index), &mesh_geom(mesh, material, middle, heading));
        }
    }
}

/// Every junction that a node can have: two streets or more, of those that the grid allows.
fn junctions(writer: &mut Writer<'_>) {
    for node in 0..NODES {
        let possible: usize =
            HEADINGS.into_iter().filter(|&h| street(node, h).is_some()).map(|h| 1 << h).sum();
        for arms in (0..=possible).filter(|arms| arms & !possible == 0 && arms.count_ones() >= 2) {
            let form = HEADINGS.into_iter().find_map(|turn| {
                let is_same = |form: usize| (form << turn | form >> (4 - turn)) & 0b1111 == arms;
                FORMS.into_iter().find(|form| is_same(form.1)).map(|(name, _)| (name, turn))
            });
            let Some((name, turn)) = form else { continue };
            for (kind, material) in
                [("road", "asphalt"), ("edges", "edge"), ("dashes", "dash"), ("walks", "walk")]
            {
                if kind != "dashes" || has_dashes(arms) {
                    let text = mesh_geom(&format!("{name}_{kind}"), material, node_m(node), turn);
                    writer.geom(pieces::junction(node, arms), &text);
                }
            }
        }
    }
}

/// Rows of buildings and trees beside streets, and trees where there is none.
fn buildings(generator: &mut Generator, writer: &mut Writer<'_>) {
    for index in 0..STREETS {
        let (node, heading) = ends(index);
        let at = |along_m: f64, aside_m: f64| {
            let ([x, y], [dx, dy]) = (node_m(node), turned([along_m, aside_m], heading));
            [x + dx, y + dy]
        };
        for (side, sign) in [(0, 1.0), (1, -1.0)] {
            for row in 0..ROWS {
                let piece = pieces::row(index, side, row);
                let (mut along_m, end_m) = ALONG_M[heading];
                while along_m + 5.0 < end_m {
                    let width_m = generator.uniform(5.0, 9.0).min(end_m - along_m);
                    let depth_m = generator.uniform(5.0, BUILDINGS_M.1 - BUILDINGS_M.0);
                    let half_height_m = generator.uniform(2.5, 7.0);
                    let [red, green, blue] =
                        [1.0, 0.92, 0.85].map(|warmth| warmth * generator.uniform(0.45, 0.85));
                    let middle_m = sign * (BUILDINGS_M.0 + depth_m / 2.0);
                    let [x, y] = at(along_m + width_m / 2.0, middle_m);
                    let mut half = [width_m / 2.0, depth_m / 2.0];
                    if heading == 1 {
                        half.reverse();
                    }
                    writer.geom(
                        piece,
                        &format!(
                            "type=\"box\" size=\"{:.2} {:.2} {half_height_m:.2}\" pos=\"{x:.2} {y:.2} {half_height_m:.2}\" rgba=\"{red:.2} {green:.2} {blue:.2} 1\"",
                            half[0], half[1],
                        ),
                    );
                    along_m += width_m + generator.uniform(0.3, 2.0);
                }
                let along_m = generator.uniform(11.0, BLOCK_M - 11.0);
                tree(generator, piece, at(along_m, sign * (KERB_M + 1.2)), writer);
            }
        }
        for _ in 0..4 {
            let place = at(generator.uniform(9.0, BLOCK_M - 9.0), generator.uniform(-5.0, 5.0));
            tree(generator, pieces::park(index), place, writer);
        }
    }
}

fn tree(generator: &mut Generator, piece: usize, [x, y]: [f64; 2], writer: &mut Writer<'_>) {
    let height_m = generator.uniform(2.2, 3.2);
    let (red, green) = (generator.uniform(0.1, 0.25), generator.uniform(0.3, 0.5));
    writer.geom(
        piece,
        &format!(
            "type=\"cylinder\" size=\"0.12 {:.2}\" pos=\"{x:.2} {y:.2} {:.2}\" rgba=\"0.35 0.25 0.15 1\"",
            height_m / 2.0,
            height_m / 2.0,
        ),
    );
    writer.geom(
        piece,
        &format!(
            "type=\"ellipsoid\" size=\"{:.2} {:.2} {:.2}\" pos=\"{x:.2} {y:.2} {:.2}\" rgba=\"{red:.2} {green:.2} 0.15 1\"",
            height_m * 0.4,
            height_m * 0.4,
            height_m * 0.45,
            height_m * 1.2,
        ),
    );
}

fn vehicles(xml: &mut String) {
    for (k, color) in COLORS.into_iter().enumerate() {
        let Place { position_m: [x, y], .. } = parked(k);
        let name = format!("vehicle_{k}");
        line(xml, 4, &format!("<body name=\"{name}\" mocap=\"true\" pos=\"{x} {y} 0\">"));
        hull(&name, color, "contype=\"8\" conaffinity=\"0\"", xml);
        line(xml, 4, "</body>");
    }
}
