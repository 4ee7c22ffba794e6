//! The triangles of a scene with facts that the checker needs. These are the blocking and the shown
//! triangles, a tree of boxes around the blocking ones, and the closed surfaces that they form.

use std::borrow::Cow;
use std::sync::OnceLock;

use glam::Vec3;

use super::surfaces::Surfaces;
use super::tree::TriangleTree;

/// The kinds of the triangles of a scene. An empty list means that the property holds for all triangles.
#[derive(Clone, Copy, Debug, Default)]
pub struct Kinds<'a> {
    /// For each triangle, true if sight lines end at it.
    pub blocks: &'a [bool],
    /// For each triangle, true if it can be in a visibility set.
    pub shows: &'a [bool],
}

impl Kinds<'_> {
    fn has(list: &[bool], triangle: u32) -> bool {
        // A triangle beyond the end of a list that is too short neither blocks nor shows.
        list.is_empty() || list.get(triangle as usize).copied().unwrap_or(false)
    }
}

/// The triangles of a scene, prepared for the checker.
pub struct Triangles<'a> {
    all: &'a [[Vec3; 3]],
    /// The triangles, with the non-blocking ones replaced by triangles without area, which form no occluder
    /// and no surface.
    blocking: Cow<'a, [[Vec3; 3]]>,
    tree: TriangleTree<'a>,
    surfaces: OnceLock<Surfaces>,
    kinds: Kinds<'a>,
}

impl<'a> Triangles<'a> {
    /// Creates the index of opaque triangles, in the order of their ids. Finds the closed surfaces on first
    /// use.
    pub fn new(all: &'a [[Vec3; 3]]) -> Self {
        Self::with_kinds(all, Kinds::default())
    }

    /// Creates the index of triangles of the given kinds.
    pub fn with_kinds(all: &'a [[Vec3; 3]], kinds: Kinds<'a>) -> Self {
        let blocks = |t: u32| Kinds::has(kinds.blocks, t);
        let ids: Vec<u32> = (0..all.len() as u32).filter(|t| blocks(*t)).collect();
        let blocking = if ids.len() == all.len() {
            Cow::Borrowed(all)
        } else {
            let only = |(t, v): (u32, &[Vec3; 3])| if blocks(t) { *v } else { [v[0]; 3] };
            Cow::Owned((0..).zip(all).map(only).collect())
        };
        Self {
            all,
            blocking,
            tree: TriangleTree::new(all, ids),
            surfaces: OnceLock::new(),
            kinds,
        }
    }

    /// Returns the triangles, in the order of their ids.
    pub fn all(&self) -> &'a [[Vec3; 3]] {
        self.all
    }

    /// Returns the triangles in the order of their ids, where only blocking triangles have an area.
    pub(super) fn blocking(&self) -> &[[Vec3; 3]] {
        &self.blocking
    }

    /// Returns true if a triangle can be in a visibility set, provided that it has an area.
    pub(super) fn shows(&self, triangle: u32) -> bool {
        Kinds::has(self.kinds.shows, triangle)
    }

    /// Returns the tree of boxes of the blocking triangles.
    pub(super) fn tree(&self) -> &TriangleTree<'a> {
        &self.tree
    }

    /// Returns the surfaces that the blocking triangles form.
    pub(super) fn surfaces(&self) -> &Surfaces {
        self.surfaces.get_or_init(|| Surfaces::new(&self.blocking))
    }
}
