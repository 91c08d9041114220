//! Triangle meshes of roads and kerbs as MJCF.

use super::mjcf::line;

/// A triangle mesh.
#[derive(Default)]
pub(in crate::tasks) struct Mesh {
    vertices: Vec<[f64; 3]>,
    faces: Vec<[usize; 3]>,
}

impl Mesh {
    /// Adds a strip through `rows`, each of which is its left and its right edge, as far as `keeps`
    /// wants the middle between two rows.
    pub(in crate::tasks) fn add_strip(
        &mut self,
        rows: &[[[f64; 2]; 2]],
        height_m: f64,
        keeps: impl Fn([f64; 2]) -> bool,
    ) {
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

    /// Adds a strip that stands `height_m` above the ground, with a wall on each side.
    pub(in crate::tasks) fn add_kerb(&mut self, rows: &[[[f64; 2]; 2]], height_m: f64) {
        self.add_strip(rows, height_m, |_| true);
        for side in [0, 1] {
            for pair in rows.windows(2) {
                let [[x, y], [next_x, next_y]] = [pair[0][side], pair[1][side]];
                let first = self.vertices.len();
                self.vertices.extend([
                    [x, y, 0.0],
                    [x, y, height_m],
                    [next_x, next_y, 0.0],
                    [next_x, next_y, height_m],
                ]);
                // Seen from outside: the left wall from the left, the right one from the right.
                let wall = if side == 0 { [[0, 1, 2], [2, 1, 3]] } else { [[1, 0, 2], [1, 2, 3]] };
                self.faces.extend(wall.map(|face| face.map(|i| first + i)));
            }
        }
    }

    /// Adds the polygon around `corners`, counter-clockwise, every corner of which sees the origin.
    pub(in crate::tasks) fn add_star(&mut self, corners: &[[f64; 2]], height_m: f64) {
        let middle = self.vertices.len();
        self.vertices.push([0.0, 0.0, height_m]);
        self.vertices.extend(corners.iter().map(|&[x, y]| [x, y, height_m]));
        let count = corners.len();
        self.faces
            .extend((0..count).map(|i| [middle, middle + 1 + i, middle + 1 + (i + 1) % count]));
    }

    /// Writes it as an asset.
    pub(in crate::tasks) fn write(&self, name: &str, xml: &mut String) {
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
