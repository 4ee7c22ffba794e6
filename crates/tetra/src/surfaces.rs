//! The triangles of a scene over their distinct points.
//!
//! Two corners are the same point when their coordinates are equal, whatever the file shares. Points are
//! numbered in the order in which triangles first name them.

use rustc_hash::FxHashMap;
use sightline_scene::topology::Solids;
use sightline_scene::{Scene, SceneError};

/// Triangles over distinct points.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surfaces {
    /// The distinct points. No coordinate is a negative zero.
    pub points: Vec<[f32; 3]>,
    /// The corners of each triangle, in id order and in the file's winding. A triangle without area keeps its
    /// place.
    pub triangles: Vec<[u32; 3]>,
    /// What each triangle does ([`FLAT`], [`BLOCKS`], [`SHOWS`], [`CLOSED`]).
    pub flags: Vec<u8>,
}

/// The lists of [`Surfaces`], wherever they are.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SurfacesView<'a> {
    /// As [`Surfaces::points`].
    pub points: &'a [[f32; 3]],
    /// As [`Surfaces::triangles`].
    pub triangles: &'a [[u32; 3]],
    /// As [`Surfaces::flags`].
    pub flags: &'a [u8],
}

/// The triangle has no area: it neither blocks nor shows.
pub const FLAT: u8 = 1;
/// Sight lines end at the triangle.
pub const BLOCKS: u8 = 2;
/// The triangle can be seen.
pub const SHOWS: u8 = 4;
/// The triangle belongs to the surface of a closed solid: a closed surface of triangles that block, with
/// normals that point out ([`Solids`]). The cavity of a solid counts as its inside.
pub const CLOSED: u8 = 8;

impl Surfaces {
    /// The lists.
    pub fn view(&self) -> SurfacesView<'_> {
        SurfacesView {
            points: &self.points,
            triangles: &self.triangles,
            flags: &self.flags,
        }
    }

    /// The triangles of a scene.
    ///
    /// # Errors
    /// As [`Solids::of`], for a scene with too many triangles.
    pub fn new(scene: &Scene) -> Result<Self, SceneError> {
        let solids = Solids::of_blocking(scene)?;
        let mut numbers: FxHashMap<[u32; 3], u32> = FxHashMap::default();
        let mut points = Vec::new();
        let mut flags = Vec::with_capacity(scene.triangles().len());
        let mut number = |v: glam::Vec3| {
            // The sum turns a negative zero into a positive one.
            let point = (v + glam::Vec3::ZERO).to_array();
            *numbers.entry(point.map(f32::to_bits)).or_insert_with(|| {
                points.push(point);
                points.len() as u32 - 1
            })
        };
        let triangles = scene
            .triangles()
            .iter()
            .map(|t| t.v.map(&mut number))
            .collect();
        for (id, t) in (0..).zip(scene.triangles()) {
            let flat = t.is_degenerate();
            let blocks = !flat && scene.blocks(id);
            let shows = !flat && scene.shows(id);
            let flag = |set: bool, flag: u8| if set { flag } else { 0 };
            let closed = solids.outward(id) == Some(1.0);
            flags.push(
                flag(flat, FLAT) | flag(blocks, BLOCKS) | flag(shows, SHOWS) | flag(closed, CLOSED),
            );
        }
        Ok(Self {
            points,
            triangles,
            flags,
        })
    }
}
