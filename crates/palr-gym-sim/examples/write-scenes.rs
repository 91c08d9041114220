//! Writes the generated scenes where the tasks read them: `cargo run -p palr-gym-sim --example
//! write-scenes`. A test holds file and generator equal.

use std::path::Path;

fn main() -> std::io::Result<()> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/lane.xml");
    std::fs::write(path, palr_gym_sim::tasks::lane_scene_mjcf(0))
}
