//! The triangles of a scene with the facts about them that the checker needs: a tree of boxes, and the closed
//! surfaces.

use std::sync::OnceLock;

use glam::Vec3;

use super::surfaces::Surfaces;
use super::tree::TriangleTree;

/// The triangles of a scene, prepared for the checker.
pub struct Triangles<'a> {
    tree: TriangleTree<'a>,
    surfaces: OnceLock<Surfaces>,
}

impl<'a> Triangles<'a> {
    /// Prepares the triangles of a scene, in the order of their ids. The closed surfaces are found on first
    /// use.
    pub fn new(all: &'a [[Vec3; 3]]) -> Self {
        Self { tree: TriangleTree::new(all), surfaces: OnceLock::new() }
    }

    /// The triangles, in the order of their ids.
    pub fn all(&self) -> &'a [[Vec3; 3]] {
        self.tree.all()
    }

    /// The triangles in a tree of boxes.
    pub(super) fn tree(&self) -> &TriangleTree<'a> {
        &self.tree
    }

    /// The surfaces that the triangles form.
    pub(super) fn surfaces(&self) -> &Surfaces {
        self.surfaces.get_or_init(|| Surfaces::new(self.all()))
    }
}
