//! Visibility certificates: what a certificate states, its bytes, and a checker.
//!
//! The checker uses integers, the triangles and the certificate. It shares no code with the search that finds certificates:
//! this crate depends on no other crate of the project but the number types.

pub mod checker;
pub mod evidence;
pub mod proof;

pub use evidence::Evidence;
pub use proof::Proof;
