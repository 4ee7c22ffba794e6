//! Reader of the certificates of a cell: the cell's own certificate, and the certificate of the cell group
//! whose box contains the cell.

use std::sync::{Arc, Mutex, PoisonError};

use super::BakedResult;
use crate::certificate::{CellCertificate, GroupCertificate, HiddenGroup, Reason};
use crate::codec;

/// The certificates that the set of one cell relies on.
pub struct Certificates {
    /// The certificate that the cell itself stores.
    pub own: CellCertificate,
    /// The certificate of the box around the cell and the cell that stores this certificate; `None` if the
    /// cell relies on no such certificate.
    above: Option<(u32, Arc<GroupCertificate>)>,
}

/// The reason why the certificates of a cell cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ReadError(String);

/// A reader of certificates with a cache of the last certificate of a cell group. One entry suffices, because
/// the cells that rely on one certificate follow each other.
#[derive(Default)]
pub struct CertificateReader(Mutex<Option<(u32, Arc<GroupCertificate>)>>);

impl CertificateReader {
    /// Reads the certificates of a cell. Returns `None` for a result without certificates.
    ///
    /// # Errors
    /// [`ReadError`] if the bytes are not valid, or the cell refers to a certificate that does not exist.
    pub fn read(
        &self,
        result: &dyn BakedResult,
        cell: u32,
    ) -> Result<Option<Certificates>, ReadError> {
        let Some(own) = own(result, cell)? else {
            return Ok(None);
        };
        let above = match own.above {
            None => None,
            Some(back) => {
                let keeper = cell.checked_sub(back).ok_or_else(|| {
                    ReadError("the cell relies on a certificate of a cell before cell 0".to_owned())
                })?;
                Some((keeper, self.group(result, keeper)?))
            }
        };
        Ok(Some(Certificates { own, above }))
    }

    /// Reads the certificate of a cell group that a cell stores. A thread holds the lock while it decodes the
    /// certificate, so that the other threads wait for it instead of decoding it again.
    fn group(
        &self,
        result: &dyn BakedResult,
        keeper: u32,
    ) -> Result<Arc<GroupCertificate>, ReadError> {
        let mut last = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, shared)) = last.as_ref().filter(|(cell, _)| *cell == keeper) {
            return Ok(Arc::clone(shared));
        }
        let certificate = own(result, keeper).map_err(|e| {
            ReadError(format!(
                "the cell relies on a certificate that cell {keeper} stores: {e}"
            ))
        })?;
        let shared = certificate
            .and_then(|c| c.shared)
            .map(Arc::new)
            .ok_or_else(|| {
                ReadError(format!(
                    "the cell relies on cell {keeper}, which stores no certificate of a cell group"
                ))
            })?;
        *last = Some((keeper, Arc::clone(&shared)));
        Ok(shared)
    }
}

impl Certificates {
    /// Returns the certificate of the box around the cell.
    pub fn above(&self) -> Option<&GroupCertificate> {
        self.above.as_ref().map(|(_, shared)| &**shared)
    }

    /// Returns the cell that stores the certificate of the box around the cell.
    pub fn keeper(&self) -> Option<u32> {
        self.above.as_ref().map(|(keeper, _)| *keeper)
    }

    /// Returns all groups of triangles that are hidden from the cell.
    pub fn hidden(&self) -> impl Iterator<Item = &HiddenGroup> {
        self.own
            .hidden
            .iter()
            .chain(self.above().into_iter().flat_map(|shared| &shared.hidden))
    }

    /// Returns the reason for one triangle, and the cell group's certificate if it contains the reason.
    pub fn about(&self, triangle: u32) -> Option<(Reason<'_>, Option<&GroupCertificate>)> {
        if let Some(reason) = self.own.about(triangle) {
            return Some((reason, None));
        }
        let shared = self.above()?;
        shared
            .about(triangle)
            .map(|hidden| (Reason::Hidden(hidden), Some(shared)))
    }
}

fn own(result: &dyn BakedResult, cell: u32) -> Result<Option<CellCertificate>, ReadError> {
    match result.certificate(cell).map_err(ReadError)? {
        None => Ok(None),
        // The cell was set aside.
        Some([]) => Ok(Some(CellCertificate::default())),
        Some(bytes) => codec::decode(bytes, result.triangle_count())
            .map(Some)
            .map_err(|e| ReadError(e.to_string())),
    }
}
