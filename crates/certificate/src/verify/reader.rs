//! Reads the certificates of a cell: its own, and that of the cell group whose box contains it.

use std::sync::{Arc, Mutex, PoisonError};

use super::BakedResult;
use crate::certificate::{CellCertificate, GroupCertificate, HiddenGroup, Reason};
use crate::codec;

/// The certificates that the set of one cell relies on.
pub struct Certificates {
    /// The cell's own certificate.
    pub own: CellCertificate,
    /// The certificate of the box around the cell, if there is one, and the cell that stores it.
    above: Option<(u32, Arc<GroupCertificate>)>,
}

/// Why the certificates of a cell cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ReadError(String);

/// Reads certificates, and caches the last certificate of a cell group: the cells that rely on one follow
/// each other.
#[derive(Default)]
pub struct CertificateReader(Mutex<Option<(u32, Arc<GroupCertificate>)>>);

impl CertificateReader {
    /// The certificates of a cell; `None` for a result without certificates.
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
                    ReadError("it relies on certificates of a cell before the first".to_owned())
                })?;
                Some((keeper, self.group(result, keeper)?))
            }
        };
        Ok(Some(Certificates { own, above }))
    }

    /// The certificate of a cell group that a cell stores. The lock is held while one thread decodes it, so
    /// that the others wait for it instead of decoding it again.
    fn group(
        &self,
        result: &dyn BakedResult,
        keeper: u32,
    ) -> Result<Arc<GroupCertificate>, ReadError> {
        let mut last = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, shared)) = last.as_ref().filter(|(cell, _)| *cell == keeper) {
            return Ok(Arc::clone(shared));
        }
        let certificate = own(result, keeper)
            .map_err(|e| ReadError(format!("it relies on certificates of cell {keeper}: {e}")))?;
        let shared = certificate
            .and_then(|c| c.shared)
            .map(Arc::new)
            .ok_or_else(|| {
                ReadError(format!(
                    "it relies on certificates of cell {keeper}, which stores none for other cells"
                ))
            })?;
        *last = Some((keeper, Arc::clone(&shared)));
        Ok(shared)
    }
}

impl Certificates {
    /// The certificate of the box around the cell.
    pub fn above(&self) -> Option<&GroupCertificate> {
        self.above.as_ref().map(|(_, shared)| &**shared)
    }

    /// The cell that stores it.
    pub fn keeper(&self) -> Option<u32> {
        self.above.as_ref().map(|(keeper, _)| *keeper)
    }

    /// All groups of triangles that are hidden from the cell.
    pub fn hidden(&self) -> impl Iterator<Item = &HiddenGroup> {
        self.own
            .hidden
            .iter()
            .chain(self.above().into_iter().flat_map(|shared| &shared.hidden))
    }

    /// The reason given for one triangle, and the cell group's certificate if the reason is from there.
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
        // A cell that was set aside.
        Some([]) => Ok(Some(CellCertificate::default())),
        Some(bytes) => codec::decode(bytes, result.triangle_count())
            .map(Some)
            .map_err(|e| ReadError(e.to_string())),
    }
}
