//! Generates the types and services from the `.proto` files, without protoc.

use std::path::PathBuf;

const FILES: [&str; 8] = [
    "palr_gym/v1/environment_service.proto",
    "palr_gym/v1/evaluation_service.proto",
    "palr_gym/v1/collection_service.proto",
    "palr_gym/v1/leakage_service.proto",
    "palr_gym/v1/render_service.proto",
    "palr_gym/v1/server_service.proto",
    "palr_gym/v1/snapshot_service.proto",
    "dm_env_rpc/v1/dm_env_rpc.proto",
];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo::rerun-if-changed=palr_gym");
    println!("cargo::rerun-if-changed=dm_env_rpc");
    println!("cargo::rerun-if-changed=google");
    let descriptors = protox::compile(FILES, ["."])?;
    let out_dir = PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(out_dir.join("descriptors.bin"), prost_encode(&descriptors))?;
    tonic_prost_build::configure()
        // Payloads stay reference-counted slices of what came in, and go out without a copy.
        .bytes(".palr_gym.v1")
        // Equal messages are equal bytes.
        .btree_map(".dm_env_rpc.v1")
        .compile_fds(descriptors)?;
    Ok(())
}

fn prost_encode(descriptors: &impl prost::Message) -> Vec<u8> {
    descriptors.encode_to_vec()
}
