//! The costs of objects. The costs of an object are the number of cells that see it, and the number of its
//! triangles that these cells draw.

use sightline_pvs::Pvs;
use sightline_scene::Scene;
use sightline_scene::clusters::clusters;

use crate::ReportError;

/// The number of objects below which a scene is split into clusters. One object alone does not locate the
/// cost.
const FEW: usize = 8;

/// An object, or a cluster of neighbouring triangles of a scene with few objects.
#[derive(Clone, Debug)]
pub struct Group {
    /// The name of the object, or the position of the cluster.
    pub name: String,
    /// The triangles of the group, ascending.
    pub triangles: Vec<u32>,
}

/// The costs of all groups in all cells.
pub struct Costs {
    /// The groups.
    pub groups: Vec<Group>,
    /// True if the groups are clusters.
    pub are_clusters: bool,
    /// For each cell, the groups with triangles in its set and the number of these triangles, ascending by
    /// group. Empty for cells without viewpoints.
    pub cells: Vec<Vec<(u32, u32)>>,
    /// The number of triangles in the sets, summed over all cells.
    pub total: u64,
}

impl Costs {
    /// Counts the costs from the sets of a result. A result that names objects or clusters draws all of their
    /// triangles.
    ///
    /// # Errors
    /// [`ReportError::Pvs`] if the result cannot be read.
    pub fn count(pvs: &Pvs, scene: &Scene) -> Result<Self, ReportError> {
        let are_clusters = scene.objects().len() < FEW;
        let groups = if are_clusters {
            clusters_of(scene)
        } else {
            objects_of(scene)
        };
        Self::count_groups(pvs, scene, groups, are_clusters)
    }

    /// Counts the costs from the sets of a result by objects, even for a scene with few objects.
    ///
    /// # Errors
    /// [`ReportError::Pvs`] if the result cannot be read.
    pub fn count_objects(pvs: &Pvs, scene: &Scene) -> Result<Self, ReportError> {
        Self::count_groups(pvs, scene, objects_of(scene), false)
    }

    fn count_groups(
        pvs: &Pvs,
        scene: &Scene,
        groups: Vec<Group>,
        are_clusters: bool,
    ) -> Result<Self, ReportError> {
        let mut group_of = vec![u32::MAX; scene.len() as usize];
        for (number, group) in (0u32..).zip(&groups) {
            group
                .triangles
                .iter()
                .for_each(|t| group_of[*t as usize] = number);
        }
        let (mut cells, mut total) = (Vec::with_capacity(pvs.cells() as usize), 0);
        let (mut ids, mut counts) = (Vec::new(), vec![0u32; groups.len()]);
        for cell in 0..pvs.cells() {
            pvs.visible(cell, &mut ids)?;
            total += ids.len() as u64;
            for id in &ids {
                // Triangles that never show are in no cluster.
                if let Some(count) = counts.get_mut(group_of[*id as usize] as usize) {
                    *count += 1;
                }
            }
            let found = counts
                .iter_mut()
                .enumerate()
                .filter(|(_, count)| **count > 0);
            cells.push(
                found
                    .map(|(group, count)| (group as u32, std::mem::take(count)))
                    .collect(),
            );
        }
        Ok(Self {
            groups,
            are_clusters,
            cells,
            total,
        })
    }

    /// Returns, for each group, the number of cells that see it and the number of its triangles that these
    /// cells draw.
    pub fn by_group(&self) -> Vec<(u32, u64)> {
        let mut all = vec![(0, 0); self.groups.len()];
        for (group, count) in self.cells.iter().flatten() {
            let totals = &mut all[*group as usize];
            *totals = (totals.0 + 1, totals.1 + u64::from(*count));
        }
        all
    }
}

fn objects_of(scene: &Scene) -> Vec<Group> {
    let to_group = |o: &sightline_scene::Object| Group {
        name: o.name.clone(),
        triangles: (o.first..o.first + o.count).collect(),
    };
    scene.objects().iter().map(to_group).collect()
}

fn clusters_of(scene: &Scene) -> Vec<Group> {
    let to_group = |triangles: Vec<u32>| {
        let corners = triangles
            .iter()
            .flat_map(|t| scene.triangles()[*t as usize].v);
        let around = sightline_scene::Aabb::around(corners);
        let at = (around.min + around.max) / 2.0;
        Group {
            name: format!("around ({:.4}, {:.4}, {:.4})", at.x, at.y, at.z),
            triangles,
        }
    };
    clusters(scene).into_iter().map(to_group).collect()
}
