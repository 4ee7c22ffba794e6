//! Patches that close the holes of a surface.

use glam::Vec3;

/// Computes patches that close the odd edges of a surface.
///
/// For each connected set of edges, the patches are the triangles between one corner of the set and each
/// edge.
///
/// An even number of odd edges meet at every corner, because each triangle has two edges there. So the other
/// edges of the patches cancel.
pub fn cover(odd: &[[Vec3; 2]]) -> Vec<[Vec3; 3]> {
    // Adding 0 turns −0 into 0.
    let key = |v: Vec3| (v + Vec3::ZERO).to_array().map(f32::to_bits);
    let mut group: Vec<usize> = (0..odd.len()).collect();
    loop {
        let before = group.clone();
        for i in 0..odd.len() {
            for j in 0..i {
                if odd[i]
                    .iter()
                    .any(|p| odd[j].iter().any(|q| key(*p) == key(*q)))
                {
                    let least = group[i].min(group[j]);
                    (group[i], group[j]) = (least, least);
                }
            }
        }
        if group == before {
            break;
        }
    }
    let order = |v: Vec3| [v.x, v.y, v.z].map(f32::to_bits);
    (0..odd.len())
        .filter_map(|i| {
            let members = (0..odd.len()).filter(|j| group[*j] == group[i]);
            let corner = members
                .flat_map(|j| odd[j])
                .min_by_key(|v| order(*v + Vec3::ZERO))?;
            let [p, q] = odd[i];
            (key(p) != key(corner) && key(q) != key(corner)).then_some([corner, p, q])
        })
        .collect()
}
