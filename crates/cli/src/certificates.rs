//! The certificates of a cell of a result: its own, and those about a box around it that are kept with it or with a cell before it.

use std::sync::{Arc, Mutex, PoisonError};

use sightline_exact::evidence::{Evidence, Hidden, Reason, Shared, codec};
use sightline_pvs::Pvs;

/// What a result keeps about one cell.
pub struct Certificates {
    /// The cell's own.
    pub own: Evidence,
    /// The cell that keeps what is about a box around this one, if there is such a box, and what it keeps.
    above: Option<(u32, Arc<Shared>)>,
}

/// Reads certificates, and remembers what the last cell kept for others: cells that name one follow each other.
#[derive(Default)]
pub struct Reader(Mutex<Option<(u32, Arc<Shared>)>>);

impl Reader {
    /// The certificates of a cell; nothing at all for a result without.
    ///
    /// # Errors
    /// What is wrong with them, in words.
    pub fn read(&self, pvs: &Pvs, cell: u32) -> Result<Option<Certificates>, String> {
        let Some(own) = own(pvs, cell)? else { return Ok(None) };
        let above = match own.above {
            None => None,
            Some(back) => {
                let keeper =
                    cell.checked_sub(back).ok_or("it rests on certificates of a cell before the first")?;
                Some((keeper, self.kept(pvs, keeper)?))
            }
        };
        Ok(Some(Certificates { own, above }))
    }

    /// What a cell keeps for others. One at a time reads, the others wait for it.
    fn kept(&self, pvs: &Pvs, keeper: u32) -> Result<Arc<Shared>, String> {
        let mut last = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, shared)) = last.as_ref().filter(|(cell, _)| *cell == keeper) {
            return Ok(Arc::clone(shared));
        }
        let evidence = own(pvs, keeper).map_err(|e| format!("it rests on those of cell {keeper}: {e}"))?;
        let shared = evidence.and_then(|e| e.shared).map(Arc::new);
        let shared = shared
            .ok_or_else(|| format!("it rests on certificates of cell {keeper}, which has none for others"))?;
        *last = Some((keeper, Arc::clone(&shared)));
        Ok(shared)
    }
}

impl Certificates {
    /// What is hidden from a box around the cell.
    pub fn above(&self) -> Option<&Shared> {
        self.above.as_ref().map(|(_, shared)| &**shared)
    }

    /// The cell that keeps this.
    pub fn keeper(&self) -> Option<u32> {
        self.above.as_ref().map(|(keeper, _)| *keeper)
    }

    /// Everything that is hidden from the cell, as it is kept.
    pub fn hidden(&self) -> impl Iterator<Item = &Hidden> {
        self.own.hidden.iter().chain(self.above().into_iter().flat_map(|shared| &shared.hidden))
    }

    /// The evidence about one triangle, and the box around the cell it is about if it is not about the cell alone.
    pub fn about(&self, triangle: u32) -> Option<(Reason<'_>, Option<&Shared>)> {
        if let Some(reason) = self.own.about(triangle) {
            return Some((reason, None));
        }
        let shared = self.above()?;
        shared.about(triangle).map(|hidden| (Reason::Hidden(hidden), Some(shared)))
    }
}

fn own(pvs: &Pvs, cell: u32) -> Result<Option<Evidence>, String> {
    match pvs.certificate(cell).map_err(|e| e.to_string())? {
        None => Ok(None),
        // A cell that was set aside.
        Some([]) => Ok(Some(Evidence::default())),
        Some(bytes) => codec::decode(bytes, pvs.triangle_count()).map(Some).map_err(|e| e.to_string()),
    }
}
