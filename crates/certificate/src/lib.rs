//! Visibility certificates: their contents, their bytes, and a checker.
//!
//! A certificate gives the reasons for the visibility set of one view cell: a witness (an unobstructed
//! segment) for each visible triangle, and proofs for the hidden ones. `docs/formats/certificate.md`
//! describes every byte and every argument, so that a second checker can be written from it.
//!
//! # Modules
//!
//! - `certificate`, `proof`: the contents ([`CellCertificate`], [`Witness`], [`Proof`]).
//! - `codec`: the bytes of a certificate.
//! - `checker`: the decision whether the reasons hold for the scene and the set.
//! - `verify`: [`verify()`], the check of a whole result. The feature `pvs` adds the reader of `.pvs` files.
//!
//! # Invariants
//!
//! - The checker decides only with integers, from the triangles and the certificate.
//! - The checker shares no code with the search that finds the reasons. This crate depends only on the number
//!   types in `crates/numbers`, and on `crates/pvs` with the feature `pvs`; the compiler enforces this.
//! - A certificate is not trusted: decoding and checking return errors and do not panic.
//!
//! # Limits
//!
//! - Certificates are about closed cells and opaque or see-through triangles. Boxes along walls, regions of
//!   viewpoints, masked triangles and the method `portals` have no certificates.
//!
//! # Example
//!
//! The smallest proof: a small triangle behind a wall, from a cell in front of the wall.
//!
//! ```
//! use glam::Vec3;
//! use sightline_certificate::certificate::{CellCertificate, HiddenGroup, Target};
//! use sightline_certificate::checker::{CellClaims, CellRefusal, Triangles, check_cell};
//! use sightline_certificate::proof::{OccluderTriangle, Proof, Step};
//! use sightline_certificate::codec;
//! use sightline_numbers::Aabb;
//!
//! let v = Vec3::new;
//! let wall = [v(-30.0, -30.0, 5.0), v(60.0, -30.0, 5.0), v(-30.0, 60.0, 5.0)];
//! let small = [v(0.0, 0.0, 10.0), v(1.0, 0.0, 10.0), v(0.0, 1.0, 10.0)];
//! let triangles = [wall, small];
//! let scene = Triangles::new(&triangles);
//!
//! // The small triangle is outside one face of the cell. The wall blocks all lines from that face to it.
//! let occluder = vec![OccluderTriangle { triangle: 0, reversed: false }];
//! let block = Step::Block { occluder: 0, negative: false, cuts: vec![] };
//! let proof = Proof { occluders: vec![occluder], steps: vec![block] };
//! let group = HiddenGroup { target: Target::Triangle, triangles: vec![1], proofs: vec![proof] };
//! let certificate = CellCertificate { hidden: vec![group], ..CellCertificate::default() };
//!
//! let cell = Aabb::new(v(0.0, 0.0, 0.0), v(1.0, 1.0, 1.0));
//! // The wall itself is undecided here; a certificate need not decide every triangle.
//! let claims =
//!     CellClaims { cell, visible: &[0], undecided: &[0], certificate: &certificate, above: None };
//! check_cell(&scene, &claims, &|_| true)?;
//!
//! // Encoding and decoding give the same certificate.
//! let bytes = codec::encode(&certificate)?;
//! assert_eq!(codec::decode(&bytes, 2)?, certificate);
//!
//! // The checker rejects an altered proof: no line passes the wall's boundary edges on their negative side.
//! let mut altered = certificate.clone();
//! altered.hidden[0].proofs[0].steps = vec![Step::Block { occluder: 0, negative: true, cuts: vec![] }];
//! let claims = CellClaims { certificate: &altered, ..claims };
//! assert!(matches!(check_cell(&scene, &claims, &|_| true), Err(CellRefusal::Hidden { .. })));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod certificate;
pub mod checker;
pub mod codec;
#[doc(hidden)]
pub mod fuzzing;
pub mod proof;
mod verify;

pub use certificate::{
    CellCertificate, GroupCertificate, HiddenBox, HiddenGroup, Reason, Target, Witness,
};
pub use proof::{OccluderTriangle, Proof};
pub use verify::{
    BakedResult, CertificateReader, Certificates, Count, Hidden, NOT_REACHED, OnProgress,
    ReadError, Refused, Report, SET_ASIDE, Sample, Totals, VerifyError, VerifyOptions, verify,
};
