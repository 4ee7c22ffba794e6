//! The rows of a block's table: one per triangle, or one per item.
//!
//! Rows are items if a job with a minimum share has clusters or objects.
//!
//! With a row for each triangle, the search has the triangles through which the neighbours of a cell see an
//! item. It therefore finds small items about as often as a bake of triangles does. With a row for each item
//! the table is small, and an item is found by its largest part. Lines meet one triangle of each class of
//! duplicates. If such a class belongs to several items, it has a separate row, which is added to the rows of
//! its items at the end.

use sightline_model::Granularity;
use sightline_scene::clusters::clusters;
use sightline_scene::{Scene, TriangleId};

/// The assignment of triangles to the rows of a table.
#[derive(Clone, Debug, Default)]
pub struct Rows {
    /// The row of each triangle; empty if the row is the triangle's id.
    by_triangle: Vec<u32>,
    /// The item of each triangle; empty if items are triangles.
    items: Vec<u32>,
    /// The number of items.
    count: u32,
    /// For each row after the items, the items that share the row's triangles.
    shared: Vec<Vec<u32>>,
    /// The triangles of each item if rows are triangles and items are not; otherwise empty.
    members: Vec<Vec<u32>>,
}

/// The item of triangles that can never be visible.
const NONE: u32 = 0;

impl Rows {
    /// Creates a row for each triangle of a scene whose items are triangles.
    pub fn triangles(scene: &Scene) -> Self {
        Self {
            count: scene.len(),
            ..Self::default()
        }
    }

    /// Creates a row for each triangle of a scene with items of this granularity.
    pub fn fine(scene: &Scene, granularity: Granularity) -> Self {
        let Some((items, count)) = items(scene, granularity) else {
            return Self::triangles(scene);
        };
        let mut members = vec![Vec::new(); count as usize];
        for (triangle, item) in (0..).zip(&items) {
            members[*item as usize].push(triangle);
        }
        Self {
            items,
            count,
            members,
            ..Self::default()
        }
    }

    /// Creates a row for each item of a scene. `duplicates` are the classes of triangles with the same three
    /// vertices.
    pub fn of_items(scene: &Scene, granularity: Granularity, duplicates: &[Vec<u32>]) -> Self {
        let Some((items, count)) = items(scene, granularity) else {
            return Self::triangles(scene);
        };
        let mut rows = items.clone();
        let mut shared = Vec::new();
        for class in duplicates {
            let mut with: Vec<u32> = class.iter().map(|t| items[*t as usize]).collect();
            with.sort_unstable();
            with.dedup();
            if with.len() > 1 {
                class
                    .iter()
                    .for_each(|t| rows[*t as usize] = count + shared.len() as u32);
                shared.push(with);
            }
        }
        Self {
            by_triangle: rows,
            items,
            count,
            shared,
            ..Self::default()
        }
    }

    /// Returns the row of each triangle. The list is empty if the row is the triangle's id.
    pub fn of_triangles(&self) -> &[u32] {
        &self.by_triangle
    }

    /// Returns the item of a triangle that can be visible.
    pub fn item(&self, triangle: TriangleId) -> u32 {
        if self.items.is_empty() {
            triangle.0
        } else {
            self.items[triangle.at()]
        }
    }

    /// Returns the number of rows.
    pub fn count(&self) -> usize {
        match (&self.by_triangle[..], &self.items[..]) {
            ([], []) => self.count as usize,
            ([], items) => items.len(),
            _ => self.count as usize + self.shared.len(),
        }
    }

    /// Returns the number of items.
    pub fn items(&self) -> u32 {
        self.count
    }

    /// Returns for each row after the items the items that share the row's triangles.
    pub fn shared(&self) -> &[Vec<u32>] {
        &self.shared
    }

    /// Returns the triangles of each item if rows are triangles and items are not. Otherwise the list is
    /// empty.
    pub fn members(&self) -> &[Vec<u32>] {
        &self.members
    }

    /// Returns true if items are triangles.
    pub fn are_triangles(&self) -> bool {
        self.items.is_empty()
    }

    /// Returns true if rows are triangles and items are not.
    pub fn are_finer(&self) -> bool {
        self.by_triangle.is_empty() && !self.items.is_empty()
    }
}

/// Returns the item of each triangle and the number of items, or `None` if items are triangles.
fn items(scene: &Scene, granularity: Granularity) -> Option<(Vec<u32>, u32)> {
    let mut items = vec![NONE; scene.triangles().len()];
    let count = match granularity {
        Granularity::Triangles => return None,
        Granularity::Objects => {
            for (number, o) in scene.objects().iter().enumerate() {
                items[o.first as usize..(o.first + o.count) as usize].fill(number as u32);
            }
            scene.objects().len()
        }
        Granularity::Clusters => {
            let all = clusters(scene);
            for (number, cluster) in all.iter().enumerate() {
                cluster
                    .iter()
                    .for_each(|t| items[*t as usize] = number as u32);
            }
            all.len()
        }
    };
    Some((items, count as u32))
}
