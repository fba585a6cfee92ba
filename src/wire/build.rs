//! Compiles `proto/` to Rust without a system `protoc`, and leaves the descriptors for reflection, with their comments.

use prost::Message;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo::rerun-if-changed=../../proto");
    let descriptors = protox::compile(
        ["tessera/v1/blob.proto", "tessera/v1/job.proto", "tessera/v1/remesh.proto", "tessera/v1/server.proto"],
        ["../../proto"],
    )?;
    let out = std::path::PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(out.join("tessera.bin"), descriptors.encode_to_vec())?;
    let mut config = tonic_prost_build::Config::new();
    config.enable_type_names();
    let builder = tonic_prost_build::configure().bytes(".").emit_rerun_if_changed(false);
    builder.compile_fds_with_config(descriptors, config)?;
    Ok(())
}
