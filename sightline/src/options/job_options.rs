//! The options of a bake, with one field per option.

use std::time::Duration;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use sightline_model::{
    CellToCell, Completion, Crediting, ErrorMeasure, Granularity, MethodName, SamplerName,
    SupersetChoice,
};

#[cfg(feature = "clap")]
use super::arguments;
use super::cell_budget::CellBudgetOptions;
use super::cells::Cells;
#[cfg(feature = "clap")]
use super::cells::parse_cells;
use super::names::option_named;
#[cfg(feature = "clap")]
use super::text;
use super::viewpoints::ViewpointOptions;
use crate::error::Error;
use crate::tracers::TracerOption;

/// The options of a bake: a field for each option of `sightline bake`. Absent options have the defaults that
/// their documentation names.
///
/// [`JobOptions::resolve`] turns options into a job for a scene. As JSON, the options are one object without
/// nesting, with the option names of the command line (`_` for `-`); options of the command line named in
/// these texts are fields here.
///
/// ```
/// use sightline::{Cells, JobOptions};
///
/// let options = JobOptions { cells: Some(Cells::Grid([8, 2, 8])), seed: Some(7), ..Default::default() };
/// let same = JobOptions::from_json(&serde_json::json!({"cells": [8, 2, 8], "seed": 7}))?;
/// assert_eq!(options, same);
/// # Ok::<(), sightline::Error>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "clap", derive(clap::Args))]
#[serde(default)]
pub struct JobOptions {
    /// The method that decides visibility. aggressive: sampling only; a cell may miss a few triangles, and no
    /// triangle is proved hidden. exact: sampling, then exact queries until every triangle has a witness or a
    /// proof. verified: as exact, with lower limits for a single query; for --time-budget. portals: no
    /// sampling; walls hide triangles, seen through the doors and windows between them. Triangles without
    /// witness or proof are undecided: a result reports them, and a viewer draws them. portals costs a small
    /// fraction of the time of exact indoors, and hides little in the open. Default: aggressive.
    #[cfg_attr(feature = "clap", arg(long, value_parser = arguments::named::<MethodName>()))]
    pub method: Option<MethodName>,
    /// Store a witness for every visible triangle and a proof for every hidden triangle, for `sightline
    /// verify` and `sightline query --why`. Needs --method exact or verified. The file becomes many times
    /// larger.
    #[cfg_attr(feature = "clap", arg(long))]
    pub certificates: bool,
    /// A regular grid of view cells: the numbers of cells along x, y and z. Or walls:N, at most N boxes of
    /// different sizes along the walls that lie across an axis; a wall in a face of such a box blocks.
    /// Without such walls, the largest boxes are halved. Default, without a triangle budget: 8x8x8.
    #[cfg_attr(feature = "clap", arg(long, value_name = "NXxNYxNZ|walls:N", value_parser = parse_cells))]
    pub cells: Option<Cells>,
    /// A regular grid of view cells with sides of at most this length, in the scene's units, instead of a
    /// number of cells.
    #[cfg_attr(feature = "clap", arg(long, value_name = "M"))]
    #[cfg_attr(feature = "clap", arg(value_parser = text::parse_size, allow_negative_numbers = true))]
    pub cell_size: Option<f64>,
    /// Adaptive cells instead of a grid: halve a cell while sampling shows more than this many triangles from
    /// it. The first three levels are always halved.
    #[cfg_attr(feature = "clap", arg(long, value_name = "T"))]
    pub triangle_budget: Option<u32>,
    /// Deepest level of the adaptive tree, 1 to 22. Needs --triangle-budget. Default: 12.
    #[cfg_attr(feature = "clap", arg(long, value_name = "D"))]
    pub max_depth: Option<u32>,
    /// The options of cells by cost.
    #[serde(flatten)]
    #[cfg_attr(feature = "clap", command(flatten))]
    pub by_cost: CellBudgetOptions,
    /// The sampler. Default: lines; for adaptive trees deeper than 12: cubes.
    #[cfg_attr(feature = "clap", arg(long, value_parser = arguments::named::<SamplerName>()))]
    pub sampler: Option<SamplerName>,
    /// The fraction of the sight lines from a cell that a finished cell is expected to miss at most,
    /// including lines that meet nothing. The fraction is an estimate, not a bound. A cell that needs many
    /// times the work of the other cells has a larger tolerance. Default: 0.0001, or the value of
    /// --max-error.
    #[cfg_attr(
        feature = "clap",
        arg(long, value_name = "F", allow_negative_numbers = true)
    )]
    pub target_error: Option<f64>,
    /// Refine each cell until the 95 % bound on the fraction of its missed sight lines is at most this. The
    /// bound comes from lines that the search does not use, and the result stores it. The bound holds on
    /// average over the cell, not for the worst viewpoint. With --target-error as well, both conditions must
    /// hold. Needs --sampler lines, and a grid or boxes along walls.
    #[cfg_attr(
        feature = "clap",
        arg(long, value_name = "F", allow_negative_numbers = true)
    )]
    pub max_error: Option<f64>,
    /// Stop this long after the submission of the job, with the best result by then: 500ms, 30s, 5m, 2h; a
    /// number without a unit is in seconds. The clock keeps running while a bake is interrupted. With a time
    /// budget, two runs need not give the same bytes. Not for --sampler cubes.
    #[cfg_attr(feature = "clap", arg(long, value_name = "DUR", value_parser = text::parse_duration))]
    #[serde(with = "duration")]
    pub time_budget: Option<Duration>,
    /// Maximum number of cells in a tile of a grid, 1 to 4096. The cells of a tile share sight lines, so
    /// larger tiles cost less in total: on grids of 2048 and more cells, tiles of all cells needed 15 % less
    /// time than tiles of 512 cells at the same error (docs/experiments/blocks.md). A tile needs two bits of
    /// memory for each pair of a cell and a triangle. Default: 512; fewer for large scenes and small errors;
    /// 8 for exact methods.
    #[cfg_attr(feature = "clap", arg(long, value_name = "N"))]
    #[cfg_attr(
        feature = "clap",
        arg(value_parser = clap::value_parser!(u32)
            .range(1..=i64::from(sightline_model::MOST_BLOCK_CELLS)))
    )]
    #[cfg_attr(feature = "clap", arg())]
    pub block_cells: Option<u32>,
    /// Rays per cell of the sampler guided. Default: 200000.
    #[cfg_attr(feature = "clap", arg(long, value_name = "N"))]
    pub rays: Option<u64>,
    /// The cells that a ray of the sampler guided credits with the triangles that it meets. all: every cell
    /// that the ray crosses before its hit; newly found triangles guide rays from these cells. own: only the
    /// cell of the ray. With --far or one-sided triangles, always own. Default: all.
    #[cfg_attr(feature = "clap", arg(long, value_parser = arguments::named::<Crediting>()))]
    pub credit: Option<Crediting>,
    /// The items that the sets name: triangles, clusters (at most 128 neighbouring triangles of an object) or
    /// objects. With clusters or objects, the sampler searches for fewer items, the tables and the file are
    /// smaller, and a cell draws a whole item when it sees a part of it. Needs --method aggressive. Default:
    /// triangles.
    #[cfg_attr(feature = "clap", arg(long, value_parser = arguments::named::<Granularity>()))]
    pub granularity: Option<Granularity>,
    /// The completion of the sets with likely triangles, as undecided. auto: the triangles on which missed
    /// sight lines most likely end, at most one for 20 seen ones, so that a target error needs less time.
    /// off: a set contains only triangles that a sight line met, or that meet the cell. Needs --method
    /// aggressive, --sampler lines and no --min-share. Default: auto.
    #[cfg_attr(feature = "clap", arg(long, value_parser = arguments::named::<Completion>()))]
    pub complete: Option<Completion>,
    /// Search until the sampler finds each item that covers at least the share S of the sight lines from a
    /// cell, with a probability of at least 95 %: 0.001 for a thousandth of the view. Replaces
    /// --target-error. Two seeds then agree on all but smaller items.
    #[cfg_attr(
        feature = "clap",
        arg(long, value_name = "S", allow_negative_numbers = true)
    )]
    pub min_share: Option<f64>,
    /// Measure, for each cell, the mean and the maximum share of the view that each visible item covers, and
    /// store both in the result (dump --contributions).
    #[cfg_attr(feature = "clap", arg(long))]
    pub contributions: bool,
    /// The distance from the viewpoint at which sight lines end, in the scene's units. Farther triangles
    /// count as not visible.
    #[cfg_attr(feature = "clap", arg(long, value_name = "D"))]
    #[cfg_attr(feature = "clap", arg(allow_negative_numbers = true, value_parser = text::parse_length))]
    pub far: Option<f32>,
    /// Compute the pairs of cells that see each other, for dump --items cells and query --sees. auto: only
    /// with at most 512 cells. on: always; more than 32768 cells are an error. off: never. Default: auto.
    #[cfg_attr(feature = "clap", arg(long, value_parser = arguments::named::<CellToCell>()))]
    pub cell_to_cell: Option<CellToCell>,
    /// The options that restrict where viewpoints can be.
    #[serde(flatten)]
    #[cfg_attr(feature = "clap", command(flatten))]
    pub viewpoints: ViewpointOptions,
    /// The options of the sampler cubes.
    #[serde(flatten)]
    #[cfg_attr(feature = "clap", command(flatten))]
    pub cubes: CubeOptions,
    /// The tracer of sight lines and renderer of cubes. auto times both on this scene and selects the faster
    /// one; the gpu has to be twice as fast as the cpu, so that timing noise does not decide. Default: auto.
    #[cfg_attr(feature = "clap", arg(long, value_parser = arguments::named::<TracerOption>()))]
    pub backend: Option<TracerOption>,
    /// Seed of the random number generator. Ignored by --sampler cubes. Default: 0.
    #[cfg_attr(feature = "clap", arg(long, value_name = "S"))]
    pub seed: Option<u64>,
}

/// The options of the sampler cubes.
///
/// ```
/// use sightline::{CubeOptions, JobOptions};
///
/// let cubes = CubeOptions { resolution: Some(128), ..Default::default() };
/// let options = JobOptions { cubes, ..Default::default() };
/// assert_eq!(serde_json::to_value(options).unwrap()["resolution"], 128);
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "clap", derive(clap::Args))]
#[cfg_attr(feature = "clap", command(next_help_heading = "Sampler cubes"))]
#[serde(default)]
pub struct CubeOptions {
    /// Side of one item buffer (a face of a cube) in pixels, 8 to 4096. Default: 256.
    #[cfg_attr(feature = "clap", arg(long, value_name = "PX"))]
    pub resolution: Option<u32>,
    /// Subdivide a sampled rectangle while the cubes at its corners differ by more than this, 0 to 1.
    /// Default: 0.1.
    #[cfg_attr(
        feature = "clap",
        arg(long, value_name = "E", allow_negative_numbers = true)
    )]
    pub error_threshold: Option<f64>,
    /// The value of --error-threshold for cubes inside closed solids, where no viewpoint is expected.
    /// Default: 0.5.
    #[cfg_attr(
        feature = "clap",
        arg(long, value_name = "E", allow_negative_numbers = true)
    )]
    pub interior_threshold: Option<f64>,
    /// Comparison of the cubes at the corners: by their sets (Err), pixel by pixel (Err′), or by their sets
    /// in each of 24 groups of directions (Err″). With uniform, no cubes are compared, and every rectangle is
    /// subdivided down to --min-distance. Default: strata.
    #[cfg_attr(feature = "clap", arg(long, value_parser = arguments::named::<ErrorMeasure>()))]
    pub error_measure: Option<ErrorMeasure>,
    /// Never subdivide a rectangle within one cell whose longer side is at most this fraction of the cell's
    /// size (the geometric mean of its three sides). Default: 0.5.
    #[cfg_attr(
        feature = "clap",
        arg(long, value_name = "F", allow_negative_numbers = true)
    )]
    pub min_distance: Option<f64>,
    /// Apply --error-threshold to all cubes, also to those inside closed solids.
    #[cfg_attr(feature = "clap", arg(long))]
    pub no_solids: bool,
    /// Render the cubes of a cell with only the triangles that its parent cell saw. auto: on for the gpu,
    /// where each drawn triangle costs time. Default: auto.
    #[cfg_attr(feature = "clap", arg(long, value_parser = arguments::named::<SupersetChoice>()))]
    pub superset: Option<SupersetChoice>,
}

impl JobOptions {
    /// Reads options from a JSON object. A null value is the same as an absent option.
    ///
    /// ```
    /// use sightline::JobOptions;
    ///
    /// let error = JobOptions::from_json(&serde_json::json!({"max_error": "low"})).unwrap_err();
    /// assert_eq!(error.option(), Some("max-error"));
    /// ```
    ///
    /// # Errors
    /// [`crate::ErrorKind::Usage`] with the name of the option, if an option is unknown or has an unsuitable
    /// value.
    pub fn from_json(object: &Value) -> Result<Self, Error> {
        let Some(given) = object.as_object() else {
            return Err(Error::usage(
                "the options must be a JSON object of names and values",
            ));
        };
        let known = serde_json::to_value(Self::default()).map_err(Error::internal)?;
        let names: Vec<&String> = known.as_object().into_iter().flat_map(Map::keys).collect();
        let mut kept = Map::new();
        for (name, value) in given.iter().filter(|(_, value)| !value.is_null()) {
            if !names.contains(&name) {
                return Err(Error::usage(format!(
                    "{name} is not an option; see `sightline bake --help`, \
                 with _ in place of -"
                )));
            }
            let alone = Map::from_iter([(name.clone(), value.clone())]);
            if let Err(e) = Self::deserialize(Value::Object(alone)) {
                let option = option_named(name);
                let error = Error::usage(format!("{name}: {e}; got {value}"));
                return Err(match option {
                    Some(option) => error.about(option),
                    None => error,
                });
            }
            kept.insert(name.clone(), value.clone());
        }
        Self::deserialize(Value::Object(kept)).map_err(|e| Error::usage(e.to_string()))
    }
}

/// The serialisation of durations as seconds or as text, for serde.
mod duration {
    use std::time::Duration;

    use serde::de::Error as _;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    #[derive(Deserialize)]
    #[serde(untagged)]
    enum DurationText {
        Seconds(f64),
        Text(String),
    }

    pub(super) fn serialize<S: Serializer>(
        duration: &Option<Duration>,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        duration.map(|d| d.as_secs_f64()).serialize(to)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(
        from: D,
    ) -> Result<Option<Duration>, D::Error> {
        let text = match Option::<DurationText>::deserialize(from)? {
            None => return Ok(None),
            Some(DurationText::Seconds(seconds)) => seconds.to_string(),
            Some(DurationText::Text(text)) => text,
        };
        let duration = crate::options::text::parse_duration(&text).map_err(D::Error::custom)?;
        Ok(Some(duration))
    }
}
