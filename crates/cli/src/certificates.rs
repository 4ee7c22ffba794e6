//! The certificates of a cell of a result: its own, and those about boxes around it that are kept with cells before it.

use std::collections::BTreeMap;

use sightline_exact::evidence::{Evidence, Hidden, Reason, Shared, codec};
use sightline_pvs::Pvs;

/// What a result keeps about one cell.
pub struct Certificates {
    /// The cell's own.
    pub own: Evidence,
    /// By how far before it they are, those of other cells that keep something for this one.
    others: BTreeMap<u32, Evidence>,
}

impl Certificates {
    /// Those of a cell; nothing at all for a result without.
    ///
    /// # Errors
    /// What is wrong with them, in words.
    pub fn of(pvs: &Pvs, cell: u32) -> Result<Option<Self>, String> {
        let Some(own) = read(pvs, cell)? else { return Ok(None) };
        let mut others = BTreeMap::new();
        for above in &own.above {
            if above.back == 0 || others.contains_key(&above.back) {
                continue;
            }
            let other =
                cell.checked_sub(above.back).ok_or("it rests on certificates of a cell before the first")?;
            let evidence = read(pvs, other)?.unwrap_or_default();
            others.insert(above.back, evidence);
        }
        let all = Self { own, others };
        match all.own.above.iter().all(|a| all.get(a.back, a.at).is_some()) {
            true => Ok(Some(all)),
            false => Err("it rests on certificates that are not there".to_owned()),
        }
    }

    fn get(&self, back: u32, at: u32) -> Option<&Shared> {
        let evidence = if back == 0 { &self.own } else { self.others.get(&back)? };
        evidence.shared.get(at as usize)
    }

    /// What is hidden from boxes around the cell.
    pub fn above(&self) -> Vec<&Shared> {
        self.own.above.iter().filter_map(|a| self.get(a.back, a.at)).collect()
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
        self.above().into_iter().find_map(|s| s.about(triangle).map(|h| (Reason::Hidden(h), Some(s))))
    }
}

fn read(pvs: &Pvs, cell: u32) -> Result<Option<Evidence>, String> {
    match pvs.evidence(cell).map_err(|e| e.to_string())? {
        None => Ok(None),
        // A cell that was set aside.
        Some([]) => Ok(Some(Evidence::default())),
        Some(bytes) => codec::decode(bytes, pvs.triangle_count()).map(Some).map_err(|e| e.to_string()),
    }
}
