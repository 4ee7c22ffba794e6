//! The triangles of a scene, with corners as indices of distinct points.
//!
//! Two corners are the same point if their coordinates are equal, even if the scene file stores the corners
//! as separate vertices. Points are numbered in the order in which triangles first reference them.

use rustc_hash::FxHashMap;
use sightline_scene::topology::Solids;
use sightline_scene::{Scene, SceneError, TriangleId};

/// The triangles of a scene, whose corners are indices of distinct points.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surfaces {
    /// The distinct points. No coordinate is a negative zero.
    pub points: Vec<[f32; 3]>,
    /// The corners of each triangle as indices into `points`, in the order of triangle ids and in the file's
    /// winding. A triangle without area also has an entry.
    pub triangles: Vec<[u32; 3]>,
    /// The sum of the flags of each triangle ([`FLAT`], [`BLOCKS`], [`SHOWS`], [`CLOSED`]).
    pub flags: Vec<u8>,
}

/// Borrowed lists of [`Surfaces`], for example from a mapped file.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SurfacesView<'a> {
    /// The distinct points ([`Surfaces::points`]).
    pub points: &'a [[f32; 3]],
    /// The corners of each triangle ([`Surfaces::triangles`]).
    pub triangles: &'a [[u32; 3]],
    /// The flags of each triangle ([`Surfaces::flags`]).
    pub flags: &'a [u8],
}

/// Flag of a triangle without area. Such a triangle neither blocks nor shows.
pub const FLAT: u8 = 1;
/// Flag of a triangle that blocks sight lines.
pub const BLOCKS: u8 = 2;
/// Flag of a triangle that can be in the set of visible triangles.
pub const SHOWS: u8 = 4;
/// Flag of a triangle on the surface of a closed solid.
///
/// The surface is closed, and its triangles block and have normals that point out ([`Solids`]). The cavity of
/// a solid counts as its inside.
pub const CLOSED: u8 = 8;

impl Surfaces {
    /// Returns borrowed views of the lists.
    pub fn view(&self) -> SurfacesView<'_> {
        SurfacesView {
            points: &self.points,
            triangles: &self.triangles,
            flags: &self.flags,
        }
    }

    /// Collects the triangles of a scene.
    ///
    /// # Errors
    /// The error of [`Solids::find`] if the scene has too many triangles.
    pub fn new(scene: &Scene) -> Result<Self, SceneError> {
        let solids = Solids::find_blocking(scene)?;
        let mut numbers: FxHashMap<[u32; 3], u32> = FxHashMap::default();
        let mut points = Vec::new();
        let mut flags = Vec::with_capacity(scene.triangles().len());
        let mut number = |v: glam::Vec3| {
            // Adding zero turns a negative zero into a positive zero.
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
            let blocks = !flat && scene.blocks(TriangleId(id));
            let shows = !flat && scene.shows(TriangleId(id));
            let flag = |set: bool, flag: u8| if set { flag } else { 0 };
            let closed = solids.outward(TriangleId(id)) == Some(1.0);
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
