//! Cells to be decided as the items of a phase that a crew shares.
//!
//! An answer is a decided cell, encoded as the output of a tile of one cell. A cell takes seconds to minutes,
//! so a member gives one up when another member's answer is here.

use std::sync::{Mutex, OnceLock, PoisonError};

use sightline_model::{CellSet, CellSets, Node, TileOutput, codec};
use sightline_numbers::varint;
use sightline_sample::crew::{Crew, ForeignFinds, Phase};
use sightline_sample::{TileError, Watcher};

/// Why the cells of a tile are not decided.
#[derive(Debug)]
pub enum Undecided {
    /// The tile was cancelled, or the crew needs this member no more.
    Cancelled,
    /// A fault of the tile.
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

/// Decides all cells, here or on other members of the crew. `compute` decides one, and may leave it half
/// decided only when the tile is cancelled or its second argument has said that the cell is not needed.
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
    /// Takes an answer in, unless there is one.
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
                nodes: vec![Node::Cell],
                cells: vec![cell.clone()],
                pairs: None,
                portals: Vec::new(),
            };
            // Writing to memory does not fail; a cell that is left out would be computed again.
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
                    .map_err(|_| ForeignFinds("a number is cut off"))
            };
            let (item, length) = (number()?, number()?);
            let item = usize::try_from(item)
                .ok()
                .filter(|item| *item < self.decided.len());
            let item = item.ok_or(ForeignFinds("it names a cell that the tile does not have"))?;
            let length = usize::try_from(length)
                .ok()
                .filter(|length| *length <= bytes.len());
            let (coded, rest) = bytes.split_at(length.ok_or(ForeignFinds("a cell is cut off"))?);
            bytes = rest;
            let sets = match codec::decode(coded, self.triangles) {
                Ok(TileOutput::Cells(sets)) => sets,
                _ => return Err(ForeignFinds("a cell cannot be read")),
            };
            let [cell] =
                <[CellSet; 1]>::try_from(sets.cells).map_err(|_| ForeignFinds("not one cell"))?;
            let of_this = cell.unreached == self.sampled[item].unreached && cell.decision.is_some();
            if !of_this {
                return Err(ForeignFinds("a cell is not decided"));
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
        // Cells that see much take long.
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
            // What was stopped is half decided.
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
