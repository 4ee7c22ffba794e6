//! The table of a partition in a result, for queries at run time.

use sightline_exact::polygon;
use sightline_pvs::portals::{LEAF, MOST_CORNERS, NONE};
use sightline_pvs::{Portal, Portals};

use crate::partition::Partition;
use crate::plane::PlaneId;
use crate::tree::{BspNode, LeafId, PortalId};

/// Creates a table of the planes, nodes, portals and triangles of the leaves that lines can enter.
pub fn table(partition: &Partition) -> Portals {
    let tree = partition.tree();
    let mut out = Portals::default();
    let bounds = tree.bounds();
    out.size =
        f64::from(bounds.min.abs().max(bounds.max.abs()).max_element()).max(f64::MIN_POSITIVE);
    // Doors with the same name have one entry, because they open and close at the same time.
    let names: Vec<&str> = partition.doors().into_iter().collect();
    out.doors = names.iter().map(|name| (*name).to_owned()).collect();
    let mut planes: Vec<Option<u32>> = vec![None; tree.planes().len()];
    let mut leaves: Vec<Option<u32>> = vec![None; tree.len()];
    // A node gets its number when the traversal reaches it, and the traversal then stores the number in the
    // parent.
    let mut open: Vec<(u32, Option<(usize, usize)>)> = vec![(0, None)];
    while let Some((at, parent)) = open.pop() {
        let number = if !partition.is_inside(at) {
            NONE
        } else {
            match tree.nodes()[at as usize] {
                BspNode::Leaf(leaf) => {
                    let number = out.leaves.len() as u32;
                    leaves[leaf.0 as usize] = Some(number);
                    // The parts ascend by triangle, and a triangle can have several parts.
                    let mut ids: Vec<u32> = partition
                        .parts(leaf)
                        .iter()
                        .map(|part| part.triangle.0)
                        .collect();
                    ids.dedup();
                    out.leaves.push(ids);
                    LEAF + number
                }
                BspNode::Split(plane, [below, above]) => {
                    let number = out.nodes.len();
                    let plane = number_of(partition, plane, &mut planes, &mut out.planes);
                    out.nodes.push([plane, NONE, NONE]);
                    open.extend([(above, Some((number, 2))), (below, Some((number, 1)))]);
                    number as u32
                }
            }
        };
        if let Some((node, side)) = parent {
            out.nodes[node][side] = number;
        }
    }
    // A result has at least one leaf.
    if out.leaves.is_empty() {
        out.leaves.push(Vec::new());
    }
    for number in 0..tree.portals() as u32 {
        let portal = tree.portal(PortalId(number));
        let leaf_number = |leaf: LeafId| leaves[leaf.0 as usize];
        if let (Some(below), Some(above), Some(plane)) = (
            leaf_number(portal.leaves[0]),
            leaf_number(portal.leaves[1]),
            portal.plane,
        ) {
            let plane = number_of(partition, plane, &mut planes, &mut out.planes);
            let door = portal
                .door
                .and_then(|door| names.binary_search(&partition.name_of(door)).ok());
            let door = door.map_or(NONE, |door| door as u32);
            // The file format limits the corners of a portal, so a larger portal is stored as several
            // portals.
            let whole = portal.face.polygon().clone();
            let pieces = if whole.points().len() > MOST_CORNERS {
                whole.pieces()
            } else {
                vec![whole]
            };
            for piece in pieces {
                let corners = piece
                    .points()
                    .iter()
                    .map(|p| polygon::rounded(p).to_array())
                    .collect();
                out.portals.push(Portal {
                    leaves: [below, above],
                    plane,
                    door,
                    corners,
                });
            }
        }
    }
    out
}

/// Returns the index of a plane in the table, and adds the plane on the first call for it.
fn number_of(
    partition: &Partition,
    plane: PlaneId,
    known: &mut [Option<u32>],
    planes: &mut Vec<[f64; 4]>,
) -> u32 {
    *known[plane.0 as usize].get_or_insert_with(|| {
        let [a, b, c, k] = partition.tree().planes().plane(plane).rounded();
        // Scale the coefficients first, so that no square overflows.
        let most = a.abs().max(b.abs()).max(c.abs());
        let [a, b, c, k] = [a, b, c, k].map(|x| x / most);
        let length = (a * a + b * b + c * c).sqrt();
        planes.push([a, b, c, k].map(|x| x / length));
        planes.len() as u32 - 1
    })
}
