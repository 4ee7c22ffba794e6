//! The encoder of a tile's output.

use rayon::prelude::*;
use sightline_numbers::memory::other_than_exhaustion;
use sightline_numbers::varint;

use super::MAX_UNPACKED;
use crate::output::{CellSet, SubtreeNode, TileOutput};
use crate::pairs::PairTable;

/// Compression level. Differences between ids contain no long matches, so levels 2 and 3 are slower and do
/// not compress better.
const LEVEL: i32 = 1;
/// Minimum number of ids for which cells are encoded on all cores. For fewer ids, waiting for the cores is
/// slower.
pub(super) const MANY: usize = 1 << 20;

/// Encodes a tile's output. Returns an error if the output exceeds [`MAX_UNPACKED`] or compression fails.
pub fn encode(output: &TileOutput) -> Result<Vec<u8>, std::io::Error> {
    let mut raw = Vec::new();
    match output {
        TileOutput::Pack(pack) => {
            raw.push(b'P');
            put(&mut raw, pack.samples.len() as u32);
            for (p, s) in &pack.samples {
                p.iter().for_each(|c| put(&mut raw, *c));
                put_ids(&mut raw, &s.ids);
                // Neighbouring ids are mostly seen in the same strata.
                let mut last = 0;
                for m in &s.strata {
                    put(&mut raw, m ^ last);
                    last = *m;
                }
                put(&mut raw, s.dominant.map_or(0, |d| d.wrapping_add(1)));
                match &s.pixels {
                    None => put(&mut raw, 0),
                    Some(pixels) => {
                        put(&mut raw, pixels.len() as u32);
                        // Runs along the rows, as in the paper (Nirenstein and Blake 2004, section 4.2.2).
                        for run in pixels.chunk_by(|a, b| a == b) {
                            put(&mut raw, run.len() as u32);
                            put(&mut raw, run[0].wrapping_add(1));
                        }
                    }
                }
            }
        }
        TileOutput::Cells(sets) => {
            raw.push(b'C');
            put(&mut raw, sets.nodes.len() as u32);
            for node in &sets.nodes {
                match node {
                    SubtreeNode::Cell => raw.push(3),
                    SubtreeNode::Split(s) => {
                        raw.push(s.axis as u8);
                        put(&mut raw, s.at);
                    }
                }
            }
            // While cells are decided exactly, the thread pool runs work that lasts minutes. A thread that
            // holds a lock here would wait for that work.
            let sampled = sets.cells.iter().all(|c| c.decision.is_none());
            let ids: usize = sets.cells.iter().map(|c| c.visible.len()).sum();
            if sampled && ids >= MANY {
                let cells: Vec<Vec<u8>> = sets
                    .cells
                    .par_iter()
                    .map(|cell| {
                        // Most ids have one byte.
                        let mut raw =
                            Vec::with_capacity(cell.visible.len() + cell.visible.len() / 4 + 64);
                        put_cell(cell, &mut raw).map(|()| raw)
                    })
                    .collect::<Result<_, _>>()?;
                raw.reserve(cells.iter().map(Vec::len).sum());
                // Each encoded cell is dropped as soon as it is copied.
                cells
                    .into_iter()
                    .for_each(|cell| raw.extend_from_slice(&cell));
            } else {
                sets.cells
                    .iter()
                    .try_for_each(|cell| put_cell(cell, &mut raw))?;
            }
            match &sets.pairs {
                None => raw.push(0),
                Some(pairs) => {
                    raw.push(if pairs.hidden.is_some() { 2 } else { 1 });
                    put(&mut raw, pairs.seen.cells());
                    put_pairs(&mut raw, &pairs.seen);
                    pairs
                        .hidden
                        .iter()
                        .for_each(|hidden| put_pairs(&mut raw, hidden));
                }
            }
            varint::write(&mut raw, sets.portals.len() as u64);
            raw.extend_from_slice(&sets.portals);
        }
    }
    if raw.len() as u64 > MAX_UNPACKED {
        return Err(std::io::Error::other(
            "a tile's output exceeds 4 GiB; use fewer --block-cells, more cells or a larger \
                --min-distance",
        ));
    }
    zstd::stream::encode_all(raw.as_slice(), LEVEL).map_err(other_than_exhaustion)
}

pub(super) fn put_cell(cell: &CellSet, raw: &mut Vec<u8>) -> Result<(), std::io::Error> {
    put_ids(raw, &cell.visible);
    put_ids(raw, &cell.undecided);
    put(raw, cell.samples);
    cell.stats
        .numbers()
        .into_iter()
        .for_each(|n| varint::write(raw, n));
    raw.push(u8::from(cell.unreached));
    match &cell.hits {
        None => raw.push(0),
        Some(hits) => {
            raw.push(1);
            put(raw, hits.viewpoints);
            put(raw, hits.lines);
            hits.counts.iter().flatten().for_each(|n| put(raw, *n));
        }
    }
    let Some(decision) = &cell.decision else {
        raw.push(0);
        return Ok(());
    };
    raw.push(1);
    put(raw, decision.counts.len() as u32);
    decision.counts.iter().for_each(|n| varint::write(raw, *n));
    let length = u32::try_from(decision.certificate.len()).map_err(std::io::Error::other)?;
    put(raw, length);
    raw.extend_from_slice(&decision.certificate);
    Ok(())
}

/// Writes for each cell the runs of pairs with this cell and with cells of a larger number.
fn put_pairs(out: &mut Vec<u8>, pairs: &PairTable) {
    (0..pairs.cells()).for_each(|cell| put_ids(out, &pairs.later(cell)));
}

fn put(out: &mut Vec<u8>, value: u32) {
    varint::write(out, value.into());
}

/// Writes the count of ascending ids, then the distance of each id from the previous id.
fn put_ids(out: &mut Vec<u8>, ids: &[u32]) {
    put(out, ids.len() as u32);
    let mut next = 0;
    for id in ids {
        put(out, id - next);
        next = id + 1;
    }
}
