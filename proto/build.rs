//! Compiles the .proto files with protox, which needs no protoc.

use std::path::PathBuf;

use prost::Message as _;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let files =
        ["jobs", "workers", "farm", "results"].map(|name| format!("sightline/v1/{name}.proto"));
    println!("cargo:rerun-if-changed=sightline");
    let set = protox::compile(files, ["."])?;
    // The descriptors for the reflection service.
    let out = PathBuf::from(std::env::var_os("OUT_DIR").ok_or("cargo sets OUT_DIR")?);
    let descriptors = set.encode_to_vec();
    std::fs::write(out.join("descriptors.bin"), &descriptors)?;
    // The JSON form of messages that Protocol Buffers define.
    pbjson_build::Builder::new()
        .register_descriptors(&descriptors)?
        .build(&[".sightline.v1"])?;
    let services = r#"#[cfg(feature = "services")]"#;
    tonic_prost_build::configure()
        // The text of an address is a secret, so src/lib.rs implements `Debug`.
        .skip_debug([".sightline.v1.Address"])
        .client_mod_attribute("sightline.v1", services)
        .server_mod_attribute("sightline.v1", services)
        .compile_fds(set)?;
    Ok(())
}
