//! The walls around the points of --reachable-from: the enclosed region, or the way out.

use std::time::{Duration, Instant};

use sightline_model::job::json::find_field;
use sightline_portals::{
    Enclosure, EnclosureLimits, Face, LeafId, RegionPlanes, Tree, enclose, reached, region_of,
};
use sightline_scene::Scene;
use sightline_viewcells::Region;

use crate::error::Error;
use crate::observer::{Observer, note};
use crate::result::NamedResult;
use crate::words::plural;

/// The time between two notes about the search.
const TELL_EVERY: Duration = Duration::from_secs(5);

/// The division of a scene along its walls, and the space that some points reach in it.
pub struct Walls {
    /// The scene divided along its walls.
    pub tree: Tree,
    /// The leaves that the points reach, ascending.
    pub reached: Vec<LeafId>,
    /// The state of the enclosure: closed, open or not known.
    pub enclosure: Enclosure,
}

impl Walls {
    /// Divides a scene until the enclosure of the points is known.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Cancelled`] if the observer cancels.
    pub fn around(
        scene: &Scene,
        points: &[[f32; 3]],
        observer: &dyn Observer,
    ) -> Result<Self, Error> {
        let mut tree = Tree::new(scene, points);
        let enclosure = refine(&mut tree, points, observer)?;
        let reached = reached(&tree, points);
        Ok(Self {
            tree,
            reached,
            enclosure,
        })
    }

    /// Returns true if a way out exists.
    pub fn is_open(&self) -> bool {
        matches!(self.enclosure, Enclosure::Leak(..))
    }

    /// Returns the enclosed region, or `None` if a way out exists or the enclosure is not known.
    pub fn region(&self) -> Result<Option<Region>, Error> {
        if self.enclosure != Enclosure::Closed {
            return Ok(None);
        }
        region_of(&self.tree, &self.reached)
            .map(Some)
            .map_err(Error::internal)
    }

    /// Formats the state of the enclosure in a sentence.
    pub fn in_words(&self) -> String {
        let leaves = plural(self.reached.len(), "convex part");
        match &self.enclosure {
            Enclosure::Closed => {
                format!(
                    "walls enclose the points of --reachable-from: {leaves} of space between them"
                )
            }
            Enclosure::Leak(..) => {
                let narrowest = self.narrowest().map_or_else(String::new, |face| {
                    let at = face.middle();
                    format!(
                        "; its narrowest opening, {} wide, is at ({}, {}, {})",
                        short(face.width()),
                        short(at.x),
                        short(at.y),
                        short(at.z)
                    )
                });
                format!(
                    "no walls enclose the points of --reachable-from: a way leads out of the scene{narrowest}"
                )
            }
            Enclosure::Unknown | Enclosure::Stopped => format!(
                "it is not known if walls enclose the points of --reachable-from: the scene has too many \
                 walls, and the search ended after {} parts of space",
                self.tree.len()
            ),
        }
    }

    /// Returns the narrowest opening of the way out, or `None` without a way out.
    pub fn narrowest(&self) -> Option<&Face> {
        let Enclosure::Leak(_, portals) = &self.enclosure else {
            return None;
        };
        let faces = portals.iter().map(|p| &self.tree.portal(*p).face);
        faces.min_by(|a, b| a.width().total_cmp(&b.width()))
    }
}

/// Divides a tree further, until the enclosure of the points is known.
///
/// # Errors
/// [`crate::ErrorKind::Cancelled`] if the observer cancels.
pub fn refine(
    tree: &mut Tree,
    points: &[[f32; 3]],
    observer: &dyn Observer,
) -> Result<Enclosure, Error> {
    let limits = EnclosureLimits::default();
    let mut told = Instant::now();
    let enclosure = enclose(tree, points, limits, &mut |leaves| {
        if told.elapsed() >= TELL_EVERY {
            told = Instant::now();
            let most = limits.leaves;
            let text = format!(
                "searching walls: divided the scene into {leaves} parts of space so far, \
             at most {most}"
            );
            note(observer, text);
        }
        !observer.is_cancelled()
    });
    match enclosure {
        Enclosure::Stopped => Err(Error::cancelled("interrupted")),
        enclosure => Ok(enclosure),
    }
}

/// Formats a number with few digits, or a very small number with its power of ten.
fn short(x: f64) -> String {
    if x != 0.0 && x.abs() < 1e-3 {
        return format!("{x:.2e}");
    }
    let text = format!("{x:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Returns `scene` if the cells of the result are boxes along walls, whose faces contain blocking walls.
/// Returns `None` for other cells.
pub fn walls_of<'a>(result: NamedResult<'_>, scene: &'a Scene) -> Option<&'a Scene> {
    find_field(&result.info()["spec"], "boxes")
        .is_some()
        .then_some(scene)
}

/// Returns the region of all viewpoints of a result, with the planes of its scene.
///
/// # Errors
/// [`crate::ErrorKind::Input`] if the region cannot be decoded.
pub fn region_of_result(
    result: NamedResult<'_>,
    scene: &Scene,
) -> Result<Option<RegionPlanes>, Error> {
    let Some(bytes) = result.pvs.region() else {
        return Ok(None);
    };
    let region = Region::decode(bytes).map_err(|e| result.error(e))?;
    RegionPlanes::new(&region, scene)
        .map(Some)
        .map_err(|e| result.error(e))
}
