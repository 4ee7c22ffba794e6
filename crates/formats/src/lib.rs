//! Readers and writers of file formats of other projects: GLB, glTF, PLY, and text in HTML.
//!
//! This crate does not depend on scenes. `crates/scene` reads scenes with this crate, and other crates write
//! files with it.
//!
//! # Modules
//!
//! - `glb`: the container of binary glTF: a header, then chunks of JSON and binary data.
//! - `gltf_edit`: an editor that adds an extension to a glTF file. All other characters of the JSON stay
//!   unchanged.
//! - `ply`: the header of a PLY file, and the numbers after the header as text or as bytes.
//! - `html`: escaping of text in HTML documents.
//!
//! # Invariants
//!
//! - Input is not trusted: functions check lengths and offsets, return errors, and do not panic.
//! - Errors name the fault; callers add the file and, except for `gltf_edit`, the remedy.
//!
//! # Example
//!
//! ```
//! use sightline_formats::glb;
//!
//! let file = glb::join(&[(glb::JSON, b"{\"asset\":{\"version\":\"2.0\"}}"), (glb::BINARY, &[1, 2, 3])])?;
//! let chunks = glb::chunks(&file)?;
//! assert_eq!((chunks[1].0, chunks[1].1), (glb::BINARY, &[1, 2, 3, 0][..]));
//! # Ok::<(), glb::GlbFault>(())
//! ```

pub mod glb;
pub mod gltf_edit;
pub mod html;
pub mod ply;
