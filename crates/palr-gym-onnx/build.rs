//! Remembers where set-up put ONNX Runtime, for binaries that run from the checkout.

fn main() {
    println!("cargo::rerun-if-env-changed=MUJOCO_DYNAMIC_LINK_DIR");
    let folder = std::env::var("MUJOCO_DYNAMIC_LINK_DIR").unwrap_or_default();
    println!("cargo::rustc-env=PALR_GYM_NATIVE_DIR={folder}");
}
