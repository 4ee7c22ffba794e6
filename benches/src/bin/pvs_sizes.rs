//! Compares the size of a result's visible sets with other encodings: `pvs_sizes RESULT.pvs`.
//!
//! Prints bytes per cell. The rows marked "ours" use the set code of the `.pvs` file. "cells apart": each set
//! separately, without the hierarchy. "thesis averages": the hierarchy of Nirenstein 2003, appendix B.1; a
//! group spans three levels of the tree, and its parent keeps an id that more than half of the children have.
//! "neighbour difference": the difference from the set of the previous cell, which a reader must decode
//! first.

#![allow(clippy::print_stdout)] // A program for people at a terminal.

use sightline_pvs::{Builder, CellTree, Header, Node, Object, Pvs};

type AnyError = Box<dyn std::error::Error>;

/// Returns the size of a single set in the code of the `.pvs` file, in bytes.
fn coded(triangles: u32, ids: &[u32]) -> Result<u64, AnyError> {
    let mut builder = Builder::new(Header {
        triangles,
        method: String::new(),
        tree: CellTree::new([[0.0; 3]; 2], vec![Node::Leaf])?,
        objects: vec![Object {
            name: String::new(),
            first: 0,
            count: triangles,
            source: None,
        }],
        info_json: String::new(),
    })?;
    builder.push_cell(ids, &[], 0)?;
    let mut file = Vec::new();
    builder.finish(&mut file)?;
    Ok(Pvs::from_bytes(file)?.visible_bytes(0)?.own)
}

fn bitmap(triangles: u32, ids: &[u32]) -> Vec<u8> {
    let mut bits = vec![0u8; (triangles as usize).div_ceil(8)];
    for &id in ids {
        bits[id as usize / 8] |= 1 << (id % 8);
    }
    bits
}

fn xor(a: &[u32], b: &[u32]) -> Vec<u32> {
    let mut both: Vec<u32> = a.iter().chain(b).copied().collect();
    both.sort_unstable();
    both.chunk_by(|x, y| x == y)
        .filter(|same| same.len() == 1)
        .map(|same| same[0])
        .collect()
}

/// Returns the ids that are in more than half of the sets.
fn majority(sets: &[Vec<u32>]) -> Vec<u32> {
    let mut all: Vec<u32> = sets.iter().flatten().copied().collect();
    all.sort_unstable();
    all.chunk_by(|x, y| x == y)
        .filter(|same| same.len() * 2 > sets.len())
        .map(|same| same[0])
        .collect()
}

/// Returns the index of the first node after the subtree at `node`.
fn after(nodes: &[Node], node: usize) -> usize {
    match nodes[node] {
        Node::Leaf => node + 1,
        Node::Split { .. } => after(nodes, after(nodes, node + 1)),
    }
}

/// Codes the subtree of `node` as in Nirenstein 2003, appendix B.1. Returns the average set of the subtree,
/// and adds the bytes of all sets below it to `bytes`.
fn thesis(pvs: &Pvs, node: usize, cell: &mut u32, bytes: &mut u64) -> Result<Vec<u32>, AnyError> {
    let nodes = pvs.tree().nodes();
    let mut group = vec![node];
    for _ in 0..3 {
        group = group
            .into_iter()
            .flat_map(|n| match nodes[n] {
                Node::Leaf => vec![n],
                Node::Split { .. } => vec![n + 1, after(nodes, n + 1)],
            })
            .collect();
    }
    if nodes[node] == Node::Leaf {
        let mut ids = Vec::new();
        pvs.visible(*cell, &mut ids)?;
        *cell += 1;
        return Ok(ids);
    }
    let mut sets = Vec::new();
    for child in group {
        sets.push(thesis(pvs, child, cell, bytes)?);
    }
    let average = majority(&sets);
    for set in &sets {
        *bytes += coded(pvs.triangle_count(), &xor(set, &average))?;
    }
    Ok(average)
}

fn main() -> Result<(), AnyError> {
    let path = std::env::args()
        .nth(1)
        .ok_or("usage: pvs_sizes RESULT.pvs")?;
    let pvs = Pvs::open(&path)?;
    let (n, cells) = (pvs.triangle_count(), pvs.cells());
    let per_cell = |bytes: u64| bytes as f64 / f64::from(cells);
    let [
        mut ids_total,
        mut apart,
        mut neighbour,
        mut roar,
        mut zstd_bits,
        mut read,
    ] = [0u64; 6];
    let (mut ids, mut before) = (Vec::new(), Vec::new());
    for cell in 0..cells {
        pvs.visible(cell, &mut ids)?;
        ids_total += ids.len() as u64;
        apart += coded(n, &ids)?;
        neighbour += coded(n, &xor(&ids, &before))?;
        let mut r = roaring::RoaringBitmap::from_sorted_iter(ids.iter().copied())?;
        r.optimize();
        roar += r.serialized_size() as u64;
        zstd_bits += zstd::bulk::compress(&bitmap(n, &ids), 19)?.len() as u64;
        read += pvs.visible_bytes(cell)?.path;
        std::mem::swap(&mut ids, &mut before);
    }
    let (mut of_thesis, mut cell) = (0, 0);
    let root = thesis(&pvs, 0, &mut cell, &mut of_thesis)?;
    of_thesis += coded(n, &root)?;
    let ours = pvs.file_bytes()[1];
    let offsets = (pvs.tree().nodes().len() as u64 + 1) * 8;
    let recoded = zstd::bulk::compress(pvs.visible_section(), 19)?.len() as u64;
    println!(
        "{n} triangles, {cells} cells, {:.0} visible a cell",
        per_cell(ids_total)
    );
    println!("bytes per cell:");
    for (name, bytes) in [
        ("roaring, run optimised", roar),
        ("zstd 19 of the bitmap", zstd_bits),
        ("ours, cells apart", apart),
        ("ours, neighbour difference", neighbour),
        ("ours, thesis averages", of_thesis),
        ("ours, as in the file", ours),
        ("  of which offsets", offsets),
        ("  zstd 19 of all of it", recoded),
        ("  read to decode a cell", read),
    ] {
        println!("  {name:<28}{:>10.0}", per_cell(bytes));
    }
    println!(
        "bits per visible id, as in the file: {:.3}",
        ours as f64 * 8.0 / ids_total.max(1) as f64
    );
    Ok(())
}
