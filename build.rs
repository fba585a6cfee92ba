//! Compiles `proto/` to Rust without a system `protoc`, and leaves the descriptors for reflection.
//! Without the feature `service` there is nothing to do.

#[cfg(feature = "service")]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    use prost::Message;

    println!("cargo::rerun-if-changed=proto");
    // The page's files are part of the program.
    println!("cargo::rerun-if-changed=ui/dist");
    let descriptors = protox::compile(
        ["tessera/v1/blob.proto", "tessera/v1/job.proto", "tessera/v1/remesh.proto", "tessera/v1/server.proto"],
        ["proto"],
    )?;
    let out = std::path::PathBuf::from(std::env::var("OUT_DIR")?);
    std::fs::write(out.join("tessera.bin"), descriptors.encode_to_vec())?;
    tonic_prost_build::configure().bytes(".").emit_rerun_if_changed(false).compile_fds(descriptors)?;
    Ok(())
}

#[cfg(not(feature = "service"))]
fn main() {
    println!("cargo::rerun-if-changed=build.rs");
}
