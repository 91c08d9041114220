//! Lets the binary find libmujoco (where the build found it, beside itself, or in `../lib`), and
//! tells it the commit that it is built from.

use std::path::Path;
use std::process::Command;

fn main() {
    println!("cargo::rerun-if-env-changed=MUJOCO_DYNAMIC_LINK_DIR");
    if let Ok(folder) = std::env::var("MUJOCO_DYNAMIC_LINK_DIR") {
        println!("cargo::rustc-link-arg=-Wl,-rpath,{folder}");
    }
    println!("cargo::rustc-link-arg=-Wl,-rpath,$ORIGIN:$ORIGIN/../lib");
    println!("cargo::rerun-if-changed=build.rs");
    // Each commit and each checkout adds a line to it.
    let log = Path::new("../../.git/logs/HEAD");
    if log.exists() {
        println!("cargo::rerun-if-changed={}", log.display());
    }
    let revision = Command::new("git").args(["rev-parse", "HEAD"]).output();
    if let Some(revision) = revision.ok().filter(|output| output.status.success()) {
        let revision = String::from_utf8_lossy(&revision.stdout);
        println!("cargo::rustc-env=PALR_GYM_GIT_REVISION={}", revision.trim());
    }
}
