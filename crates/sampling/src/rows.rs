//! The rows of the table of what cells see: one a triangle, or one an item when the job's granularity is
//! clusters or objects.
//!
//! Lines meet one triangle of each class of duplicates. Where such a class belongs to several items, it has a
//! row of its own, which is added to the rows of its items in the end.

use sightline_model::Granularity;
use sightline_scene::Scene;
use sightline_scene::clusters::clusters;

/// Which row of the table each triangle has.
#[derive(Clone, Debug, Default)]
pub struct Rows {
    /// Row of each triangle; empty when a triangle's row is its id.
    of: Vec<u32>,
    /// Item of each triangle; empty when items are triangles.
    items: Vec<u32>,
    /// Number of items.
    count: u32,
    /// For each row after the items, the items that share its triangles.
    shared: Vec<Vec<u32>>,
}

/// The item of triangles that can never be visible.
const NONE: u32 = 0;

impl Rows {
    /// A row for each triangle.
    pub fn triangles(scene: &Scene) -> Self {
        Self { count: scene.len(), ..Self::default() }
    }

    /// The rows of a scene at a granularity. `duplicates` are the classes of triangles with the same three
    /// vertices.
    pub fn new(scene: &Scene, granularity: Granularity, duplicates: &[Vec<u32>]) -> Self {
        let mut items = vec![NONE; scene.triangles().len()];
        let count = match granularity {
            Granularity::Triangles => return Self::triangles(scene),
            Granularity::Objects => {
                for (number, o) in scene.objects().iter().enumerate() {
                    items[o.first as usize..(o.first + o.count) as usize].fill(number as u32);
                }
                scene.objects().len()
            }
            Granularity::Clusters => {
                let all = clusters(scene);
                for (number, cluster) in all.iter().enumerate() {
                    cluster.iter().for_each(|t| items[*t as usize] = number as u32);
                }
                all.len()
            }
        } as u32;
        let mut of = items.clone();
        let mut shared = Vec::new();
        for class in duplicates {
            let mut with: Vec<u32> = class.iter().map(|t| items[*t as usize]).collect();
            with.sort_unstable();
            with.dedup();
            if with.len() > 1 {
                class.iter().for_each(|t| of[*t as usize] = count + shared.len() as u32);
                shared.push(with);
            }
        }
        Self { of, items, count, shared }
    }

    /// The row of each triangle; empty when a triangle's row is its id.
    pub fn of_triangles(&self) -> &[u32] {
        &self.of
    }

    /// The item of a triangle that can be visible.
    pub fn item(&self, triangle: u32) -> u32 {
        if self.items.is_empty() { triangle } else { self.items[triangle as usize] }
    }

    /// Number of rows.
    pub fn count(&self) -> usize {
        self.count as usize + self.shared.len()
    }

    /// Number of items.
    pub fn items(&self) -> u32 {
        self.count
    }

    /// For each row after the items, the items that share its triangles.
    pub fn shared(&self) -> &[Vec<u32>] {
        &self.shared
    }

    /// Whether items are triangles.
    pub fn are_triangles(&self) -> bool {
        self.items.is_empty()
    }
}
