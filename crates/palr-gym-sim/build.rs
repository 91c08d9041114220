//! Compiles the guard around MuJoCo, and lets test binaries find libmujoco where the build found it.

fn main() {
    println!("cargo::rerun-if-changed=src/guard.c");
    cc::Build::new().file("src/guard.c").std("gnu11").warnings(true).compile("palr_gym_guard");
    println!("cargo::rerun-if-env-changed=MUJOCO_DYNAMIC_LINK_DIR");
    if let Ok(folder) = std::env::var("MUJOCO_DYNAMIC_LINK_DIR") {
        println!("cargo::rustc-link-arg=-Wl,-rpath,{folder}");
    }
    // Where set-up puts what it fetches: OSMesa may be beside it.
    let folder = std::env::var("MUJOCO_DYNAMIC_LINK_DIR").unwrap_or_default();
    println!("cargo::rustc-env=PALR_GYM_NATIVE_DIR={folder}");
}
