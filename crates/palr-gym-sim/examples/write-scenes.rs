//! Writes the generated scenes where the tasks read them: `cargo run -p palr-gym-sim --example
//! write-scenes`. A test holds files and generators equal. `-- 7 FOLDER` writes those of
//! seed 7 into a folder instead.

use std::path::{Path, PathBuf};

use palr_gym_sim::tasks::{lane_scene_mjcf, town_scene_mjcf};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let seed = arguments.next().map_or(Ok(0), |seed| seed.parse())?;
    let own = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes");
    let folder = arguments.next().map_or_else(own, PathBuf::from);
    std::fs::write(folder.join("lane.xml"), lane_scene_mjcf(seed))?;
    Ok(std::fs::write(folder.join("town.xml"), town_scene_mjcf(seed))?)
}
