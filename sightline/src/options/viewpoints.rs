//! The options that restrict where viewpoints can be.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use sightline_model::Up;
use sightline_scene::Aabb;

use crate::error::Error;

/// The options that restrict where viewpoints can be. Positions are in world space, in the scene's units.
///
/// ```
/// use sightline::ViewpointOptions;
///
/// let options: ViewpointOptions =
///     serde_json::from_str(r#"{"view_box": [[0, 0, 0, 10, 3, 10]], "reachable_from": [[1, 1, 1]]}"#)?;
/// assert_eq!(options.view_box[0].max.y, 3.0);
/// # Ok::<(), serde_json::Error>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "clap", derive(clap::Args))]
#[cfg_attr(
    feature = "clap",
    command(next_help_heading = "Where viewpoints can be")
)]
#[serde(default)]
pub struct ViewpointOptions {
    /// A box of viewpoints, in world space: x0,y0,z0,x1,y1,z1. May be given several times: viewpoints are in
    /// any of the boxes, and the cells divide the box around all of them. Default: the scene's bounds.
    #[serde(with = "boxes")]
    #[cfg_attr(feature = "clap", arg(long, value_name = "BOX", value_parser = super::text::parse_box))]
    #[cfg_attr(feature = "clap", arg(allow_hyphen_values = true))]
    pub view_box: Vec<Aabb>,
    /// A scene file with closed volumes that hold all viewpoints or, with --eye-heights, a navigation mesh.
    #[cfg_attr(feature = "clap", arg(long, value_name = "FILE"))]
    pub view_mesh: Option<PathBuf>,
    /// Viewpoints are at these heights above the triangles of --view-mesh, from the first to the second, in
    /// the scene's units.
    #[cfg_attr(feature = "clap", arg(long, value_name = "LO,HI", value_parser = super::text::parse_heights))]
    #[cfg_attr(feature = "clap", arg(allow_hyphen_values = true))]
    pub eye_heights: Option<[f32; 2]>,
    /// A file of viewpoints, such as telemetry or a camera path: a line `x y z` or `x y z weight` for each.
    /// Viewpoints of weight 0 are skipped; `measure --viewpoints-file` uses the other weights.
    #[cfg_attr(feature = "clap", arg(long, value_name = "FILE"))]
    pub viewpoints: Option<PathBuf>,
    /// Viewpoints are also where an unobstructed segment of at most this length from a point of --viewpoints
    /// ends.
    #[cfg_attr(feature = "clap", arg(long, value_name = "R", value_parser = super::text::parse_length))]
    #[cfg_attr(feature = "clap", arg(allow_negative_numbers = true))]
    pub reach: Option<f32>,
    /// Viewpoints are the points that a viewer reaches from this point along any number of unobstructed
    /// segments. May be given several times. If walls enclose the points, viewpoints are exactly between
    /// these walls, also in parts of cells. If a way leads out of the scene, the program prints the narrowest
    /// opening of the way, and marks parts of cells (64 per cell) with rays; it omits parts behind gaps that
    /// no ray passes.
    #[cfg_attr(feature = "clap", arg(long, value_name = "X,Y,Z", value_parser = super::text::parse_point))]
    #[cfg_attr(feature = "clap", arg(allow_hyphen_values = true))]
    pub reachable_from: Vec<[f32; 3]>,
    /// The axis of the scene that points up. This option does not rotate the scene: --eye-heights uses the
    /// axis, and the result stores it. Default: y.
    #[cfg_attr(feature = "clap", arg(long, value_parser = super::arguments::named::<Up>()))]
    pub up: Option<Up>,
}

impl ViewpointOptions {
    /// Checks the numbers, because programs and JSON can give numbers in any range.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Usage`] with the option that is out of its range.
    pub(super) fn check(&self) -> Result<(), Error> {
        if let Some([low, high]) = self.eye_heights
            && !(low.is_finite() && high.is_finite() && low <= high)
        {
            return Err(Error::usage(format!(
                "--eye-heights {low},{high}: give the minimum and the maximum height, such as 1.2,1.8"
            ))
            .about("eye-heights"));
        }
        if let Some(reach) = self.reach
            && !(reach.is_finite() && reach > 0.0)
        {
            return Err(Error::usage(format!(
                "--reach {reach}: give a length above 0, such as 2.5"
            ))
            .about("reach"));
        }
        Ok(())
    }
}

/// The serialisation of boxes as six numbers each, for serde.
mod boxes {
    use glam::Vec3;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};
    use sightline_scene::Aabb;

    pub(super) fn serialize<S: Serializer>(boxes: &[Aabb], to: S) -> Result<S::Ok, S::Error> {
        let corners = |b: &Aabb| [b.min.to_array(), b.max.to_array()].concat();
        let rows: Vec<Vec<f32>> = boxes.iter().map(corners).collect();
        rows.serialize(to)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Aabb>, D::Error> {
        let rows = Vec::<[f32; 6]>::deserialize(from)?;
        let from_corners = |[x0, y0, z0, x1, y1, z1]: [f32; 6]| {
            Aabb::new(Vec3::new(x0, y0, z0), Vec3::new(x1, y1, z1))
        };
        Ok(rows.into_iter().map(from_corners).collect())
    }
}
