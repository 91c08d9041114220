//! What a camera cannot see need not be drawn: a picture without it is the same, bit for bit.

use mujoco_rs::mujoco_c::mjvGLCamera;

/// Single precision is not to decide at the very edge: spheres are taken a little larger.
const MARGIN: f32 = 1.01;
const MARGIN_M: f32 = 1e-3;

/// The pyramid between a perspective camera's near and far planes.
pub(super) struct Frustum {
    /// Of the camera.
    position: [f32; 3],
    /// Normals of unit length, pointing inwards, with how far the camera is inside of each.
    planes: [([f32; 3], f32); 6],
}

impl Frustum {
    /// What MuJoCo draws in a picture whose width is `aspect` times its height; `None` for a parallel
    /// projection.
    pub(super) fn new(camera: &mjvGLCamera, aspect: f32) -> Option<Self> {
        let (near, far) = (camera.frustum_near, camera.frustum_far);
        let (bottom, top) = (camera.frustum_bottom, camera.frustum_top);
        if camera.orthographic != 0 || near <= 0.0 {
            return None;
        }
        // A scene may name a width; then the larger one is sure to hold the picture.
        let half_width = camera.frustum_width.max(0.5 * aspect * (top - bottom));
        let (left, right) =
            (camera.frustum_center - half_width, camera.frustum_center + half_width);
        let (forward, up) = (unit(camera.forward)?, unit(camera.up)?);
        let sideways = cross(forward, up);
        // A plane through the camera that cuts the near plane at `edge` along `axis`.
        let side = |axis: [f32; 3], edge: f32, sign: f32| {
            let normal = std::array::from_fn(|i| sign * (edge / near * forward[i] - axis[i]));
            unit(normal).map(|normal| (normal, 0.0))
        };
        Some(Self {
            position: camera.pos,
            planes: [
                (forward, -near),
                (forward.map(|part| -part), far),
                side(sideways, right, 1.0)?,
                side(sideways, left, -1.0)?,
                side(up, top, 1.0)?,
                side(up, bottom, -1.0)?,
            ],
        })
    }

    /// False only if nothing of the sphere can be seen.
    pub(super) fn may_show(&self, centre: [f32; 3], radius: f32) -> bool {
        let from_camera = std::array::from_fn(|i| centre[i] - self.position[i]);
        let reach = radius * MARGIN + MARGIN_M;
        self.planes.iter().all(|(normal, offset)| dot(*normal, from_camera) + offset >= -reach)
    }
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(vector: [f32; 3]) -> Option<[f32; 3]> {
    let length = dot(vector, vector).sqrt();
    (length > 0.0).then(|| vector.map(|part| part / length))
}
