//! The bytes of files that others define: GLB and its chunks, PLY's header and numbers, text in HTML, and
//! changes of glTF that keep the rest of a document as it is.
//!
//! This crate does not depend on scenes. Its errors name the fault; callers add the file and the remedy.
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
