//! Visibility certificates: what a certificate states, its bytes, and a checker.

pub mod certificate;
pub mod checker;
pub mod codec;
#[doc(hidden)]
pub mod fuzzing;
pub mod proof;
mod verify;

pub use certificate::{CellCertificate, GroupCertificate, HiddenGroup, Reason, Target, Witness};
pub use proof::{OccluderTriangle, Proof};
pub use verify::{
    BakedResult, CertificateReader, Certificates, Count, Hidden, OnProgress, ReadError, Refused, Report,
    SET_ASIDE, Sample, Totals, VerifyError, VerifyOptions, verify,
};
