//! Parser of the structured sections, used when a file is opened. The parser checks counts against the length
//! of the section before it allocates memory for them.

use crate::error::PvsError;
use crate::layout::{Section, u32_at, u64_at};
use crate::tree::{CellTree, Node};
use crate::{Object, Source};

/// Parses the tree section.
pub fn read_tree(bytes: &[u8], nodes: u32) -> Result<CellTree, PvsError> {
    if bytes.len() as u64 != 24 + u64::from(nodes) * 8 {
        return Err(Section::Tree.malformed("the number of nodes differs from the header's"));
    }
    let float = |at: usize| f32::from_bits(u32_at(bytes, at));
    let view_box = [0, 1].map(|side| [0, 1, 2].map(|axis| float((side * 3 + axis) * 4)));
    let nodes =
        (24..bytes.len())
            .step_by(8)
            .map(|at| match u32_at(bytes, at) {
                axis @ 0..=2 => Ok(Node::Split {
                    axis: axis as u8,
                    at: float(at + 4),
                }),
                3 => Ok(Node::Leaf),
                other => Err(Section::Tree
                    .malformed(format!("a node has axis {other}, which is not 0 to 3"))),
            })
            .collect::<Result<Vec<_>, _>>()?;
    CellTree::new(view_box, nodes)
}

/// Parses the object section, without checking that the objects tile the triangles.
pub fn read_objects(bytes: &[u8]) -> Result<Vec<Object>, PvsError> {
    let bad = |reason: &str| Section::Objects.malformed(reason);
    let (count, rest) = bytes
        .split_first_chunk::<4>()
        .ok_or_else(|| bad("the number of objects is missing"))?;
    let table_len = u32::from_le_bytes(*count) as usize as u64 * 12;
    let (table, mut names) = usize::try_from(table_len)
        .ok()
        .and_then(|length| rest.split_at_checked(length))
        .ok_or_else(|| bad("the number of objects does not fit the length of the section"))?;
    let mut objects = Vec::with_capacity(table.len() / 12);
    for entry in table.chunks_exact(12) {
        let (name, after) = names
            .split_at_checked(u32_at(entry, 8) as usize)
            .ok_or_else(|| bad("a name reaches beyond the end of the section"))?;
        names = after;
        let name = std::str::from_utf8(name)
            .map_err(|e| Section::Objects.malformed(e.to_string()))?
            .to_owned();
        objects.push(Object {
            name,
            first: u32_at(entry, 0),
            count: u32_at(entry, 4),
            source: None,
        });
    }
    if names.is_empty() {
        Ok(objects)
    } else {
        Err(bad("bytes follow the last name"))
    }
}

/// Parses the glTF indices of the objects, and stores them in `objects`.
pub fn read_sources(bytes: &[u8], objects: &mut [Object]) -> Result<(), PvsError> {
    if bytes.len() != objects.len() * SOURCE_BYTES {
        return Err(
            Section::Sources.malformed("the number of entries differs from the number of objects")
        );
    }
    let there = |index: u32| (index != u32::MAX).then_some(index);
    for (object, entry) in objects.iter_mut().zip(bytes.chunks_exact(SOURCE_BYTES)) {
        let [node, mesh, primitive, instance] = [0, 4, 8, 12].map(|at| there(u32_at(entry, at)));
        object.source = match (node, mesh, primitive) {
            (Some(node), Some(mesh), Some(primitive)) => Some(Source {
                node,
                mesh,
                primitive,
                instance,
            }),
            (None, None, None) => None,
            _ => {
                return Err(Section::Sources
                    .malformed("an object has some, but not all, of node, mesh and primitive"));
            }
        };
    }
    Ok(())
}

/// Returns the section that [`read_sources`] parses, which is empty if no object has a source.
pub fn source_section(objects: &[Object]) -> Vec<u8> {
    if objects.iter().all(|o| o.source.is_none()) {
        return Vec::new();
    }
    let entry = |o: &Object| match o.source {
        Some(s) => [s.node, s.mesh, s.primitive, s.instance.unwrap_or(u32::MAX)],
        None => [u32::MAX; 4],
    };
    objects
        .iter()
        .flat_map(entry)
        .flat_map(u32::to_le_bytes)
        .collect()
}

/// The size of an object's source, in bytes.
const SOURCE_BYTES: usize = 16;

/// Checks that the offsets of the nodes' sets ascend from 0 to the end of the section.
pub fn check_offsets(section: Section, bytes: &[u8], nodes: u32) -> Result<(), PvsError> {
    let table = (u64::from(nodes) + 1) * 8;
    let sets = (bytes.len() as u64)
        .checked_sub(table)
        .ok_or_else(|| section.malformed("offsets are missing"))?;
    let mut last = 0;
    for node in 0..=nodes as usize {
        let offset = u64_at(bytes, node * 8);
        if (node == 0 && offset != 0) || offset < last {
            return Err(section.malformed(format!(
                "the offset of node {node} is below the previous offset, or the first is not 0"
            )));
        }
        last = offset;
    }
    if last == sets {
        Ok(())
    } else {
        Err(section.malformed("the last offset is not the end of the section"))
    }
}
