//! The cells to be decided, as the items of a phase that a crew shares.
//!
//! An answer is a decided cell, encoded as the output of a tile of one cell. A cell costs seconds to minutes,
//! so a member stops deciding a cell when it receives another member's answer.

use std::sync::{Mutex, OnceLock, PoisonError};

use sightline_model::{CellSet, CellSets, SubtreeNode, TileOutput, codec};
use sightline_numbers::varint;
use sightline_sample::crew::{Crew, ForeignFinds, Phase};
use sightline_sample::{TileError, Watcher};

/// The reason why the cells of a tile are not decided.
#[derive(Debug)]
pub enum Undecided {
    /// The tile was cancelled, or the crew no longer needs this member.
    Cancelled,
    /// The tile cannot be computed, for this reason.
    Fault(String),
}

impl From<String> for Undecided {
    fn from(reason: String) -> Self {
        Self::Fault(reason)
    }
}

type Compute<'a> = dyn Fn(usize, &(dyn Fn() -> bool + Sync)) -> Result<CellSet, String> + Sync + 'a;

struct Cells<'a> {
    sampled: &'a [CellSet],
    triangles: u32,
    compute: &'a Compute<'a>,
    watcher: &'a dyn Watcher,
    decided: Vec<OnceLock<CellSet>>,
    fault: Mutex<Option<String>>,
}

/// Decides all cells, on this member or on other members of the crew.
///
/// `compute` decides one cell. It may return a partly decided cell only if the tile is cancelled or its
/// second argument returned true, because the cell is not needed.
pub fn decide_shared(
    crew: &dyn Crew,
    sampled: &[CellSet],
    triangles: u32,
    compute: &Compute<'_>,
    watcher: &dyn Watcher,
) -> Result<Vec<CellSet>, Undecided> {
    let decided = sampled.iter().map(|_| OnceLock::new()).collect();
    let cells = Cells {
        sampled,
        triangles,
        compute,
        watcher,
        decided,
        fault: Mutex::new(None),
    };
    let ran = crew.run(&cells);
    if let Some(fault) = cells
        .fault
        .into_inner()
        .unwrap_or_else(PoisonError::into_inner)
    {
        return Err(Undecided::Fault(fault));
    }
    match ran {
        Ok(()) => {}
        Err(TileError::Cancelled) => return Err(Undecided::Cancelled),
        Err(e) => return Err(Undecided::Fault(e.to_string())),
    }
    cells
        .decided
        .into_iter()
        .map(|cell| cell.into_inner().ok_or(Undecided::Cancelled))
        .collect()
}

impl Cells<'_> {
    /// Stores `cell` as the answer of the item, unless the item already has an answer. Returns true if the
    /// answer was stored.
    fn set(&self, item: usize, cell: CellSet) -> bool {
        let is_news = self.decided[item].set(cell).is_ok();
        if is_news {
            self.watcher.cell_done();
        }
        is_news
    }

    fn encode(&self, items: impl Iterator<Item = usize>) -> Vec<u8> {
        let mut bytes = Vec::new();
        for (item, cell) in items.filter_map(|item| Some((item, self.decided[item].get()?))) {
            let alone = CellSets {
                nodes: vec![SubtreeNode::Cell],
                cells: vec![cell.clone()],
                pairs: None,
                portals: Vec::new(),
            };
            // Writing to memory does not fail. A cell that is skipped would be computed again.
            let Ok(coded) = codec::encode(&TileOutput::Cells(alone)) else {
                continue;
            };
            varint::write(&mut bytes, item as u64);
            varint::write(&mut bytes, coded.len() as u64);
            bytes.extend(coded);
        }
        bytes
    }

    fn decode(&self, mut bytes: &[u8]) -> Result<Vec<(usize, CellSet)>, ForeignFinds> {
        let mut cells = Vec::new();
        while !bytes.is_empty() {
            let mut number = || {
                varint::read(&mut bytes, varint::MOST_BYTES)
                    .map_err(|_| ForeignFinds("the number or the length of a cell is cut short"))
            };
            let (item, length) = (number()?, number()?);
            let item = usize::try_from(item)
                .ok()
                .filter(|item| *item < self.decided.len());
            let item = item.ok_or(ForeignFinds(
                "the number of a cell is too large for the tile",
            ))?;
            let length = usize::try_from(length)
                .ok()
                .filter(|length| *length <= bytes.len());
            let (coded, rest) = bytes.split_at(length.ok_or(ForeignFinds("a cell is cut short"))?);
            bytes = rest;
            let sets = match codec::decode(coded, self.triangles) {
                Ok(TileOutput::Cells(sets)) => sets,
                _ => return Err(ForeignFinds("a cell cannot be read")),
            };
            let [cell] = <[CellSet; 1]>::try_from(sets.cells)
                .map_err(|_| ForeignFinds("an answer does not contain exactly one cell"))?;
            let of_this = cell.unreached == self.sampled[item].unreached && cell.decision.is_some();
            if !of_this {
                return Err(ForeignFinds(
                    "a cell is not decided, or its unreached flag is wrong",
                ));
            }
            cells.push((item, cell));
        }
        Ok(cells)
    }
}

impl Phase for Cells<'_> {
    fn items(&self) -> usize {
        self.decided.len()
    }

    fn prepare(&self) {}

    fn costs(&self) -> Vec<u64> {
        // Cells with many visible triangles cost much time.
        self.sampled
            .iter()
            .map(|cell| cell.visible.len() as u64)
            .collect()
    }

    fn compute(
        &self,
        item: usize,
        is_needless: &(dyn Fn() -> bool + Sync),
    ) -> Result<(), TileError> {
        match (self.compute)(item, is_needless) {
            // A stopped cell is only partly decided.
            Ok(_) if self.watcher.cancelled() => Err(TileError::Cancelled),
            Ok(_) if is_needless() => Ok(()),
            Ok(cell) => {
                self.set(item, cell);
                Ok(())
            }
            Err(reason) => {
                self.fault
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .get_or_insert(reason);
                Err(TileError::Cancelled)
            }
        }
    }

    fn has(&self, item: usize) -> bool {
        self.decided
            .get(item)
            .is_some_and(|cell| cell.get().is_some())
    }

    fn take(&self, items: &[usize]) -> Vec<u8> {
        self.encode(items.iter().copied())
    }

    fn add(&self, finds: &[u8]) -> Result<u64, ForeignFinds> {
        let mut queries = 0;
        for (item, cell) in self.decode(finds)? {
            let asked = cell.decision.as_ref().map_or(0, |d| d.queries());
            if self.set(item, cell) {
                queries += asked;
            }
        }
        Ok(queries)
    }

    fn outcome(&self) -> Vec<u8> {
        self.encode(0..self.decided.len())
    }
}
