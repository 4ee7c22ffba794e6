//! The triangles of a scene with the facts about them that the checker needs: which block and which show, a
//! tree of boxes around the blocking ones, and the closed surfaces that they form.

use std::borrow::Cow;
use std::sync::OnceLock;

use glam::Vec3;

use super::surfaces::Surfaces;
use super::tree::TriangleTree;

/// Which triangles of a scene block and which show. An empty list means that all do.
#[derive(Clone, Copy, Debug, Default)]
pub struct Kinds<'a> {
    /// By triangle, whether sight lines end at it.
    pub blocks: &'a [bool],
    /// By triangle, whether it can be in a visibility set.
    pub shows: &'a [bool],
}

impl Kinds<'_> {
    fn has(list: &[bool], triangle: u32) -> bool {
        // A triangle beyond a list that is too short neither blocks nor shows.
        list.is_empty() || list.get(triangle as usize).copied().unwrap_or(false)
    }
}

/// The triangles of a scene, prepared for the checker.
pub struct Triangles<'a> {
    all: &'a [[Vec3; 3]],
    /// The triangles, those that do not block without area: they form no occluder and no surface.
    blocking: Cow<'a, [[Vec3; 3]]>,
    tree: TriangleTree<'a>,
    surfaces: OnceLock<Surfaces>,
    kinds: Kinds<'a>,
}

impl<'a> Triangles<'a> {
    /// Prepares opaque triangles, in the order of their ids. The closed surfaces are found on first use.
    pub fn new(all: &'a [[Vec3; 3]]) -> Self {
        Self::with_kinds(all, Kinds::default())
    }

    /// Prepares triangles of some kinds.
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

    /// The triangles, in the order of their ids.
    pub fn all(&self) -> &'a [[Vec3; 3]] {
        self.all
    }

    /// The triangles, in the order of their ids, with an area only where they block.
    pub(super) fn blocking(&self) -> &[[Vec3; 3]] {
        &self.blocking
    }

    /// Whether a triangle can be in a visibility set, if it has an area.
    pub(super) fn shows(&self, triangle: u32) -> bool {
        Kinds::has(self.kinds.shows, triangle)
    }

    /// The blocking triangles in a tree of boxes.
    pub(super) fn tree(&self) -> &TriangleTree<'a> {
        &self.tree
    }

    /// The surfaces that the blocking triangles form.
    pub(super) fn surfaces(&self) -> &Surfaces {
        self.surfaces.get_or_init(|| Surfaces::new(&self.blocking))
    }
}
