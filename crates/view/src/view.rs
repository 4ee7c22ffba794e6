//! The contents that a page has for every result: the default heat maps and the first cell.

use serde_json::Value;
use sightline_numbers::ids::CellIndex;
use sightline_pvs::{Pvs, PvsError};
use sightline_scene::Scene;

use crate::{Map, View};

impl<'a> View<'a> {
    /// Creates a page that contains only the data of a result, without a description.
    ///
    /// # Errors
    /// [`PvsError`] if the result cannot be read.
    pub fn new(pvs: &'a Pvs, scene: Option<&'a Scene>) -> Result<Self, PvsError> {
        let info: Value = serde_json::from_str(pvs.info_json()).unwrap_or_default();
        Ok(Self {
            pvs,
            scene,
            title: String::new(),
            about: String::new(),
            up: if info["spec"]["visibility"]["up"] == "z" {
                2
            } else {
                1
            },
            maps: maps(pvs)?,
            places: Vec::new(),
            worst: Vec::new(),
            far: info["spec"]["visibility"]["far"].as_f64(),
            caveat: caveat(pvs, scene, &info),
            ask: None,
            start: median_cell(pvs)?,
            nonce: String::new(),
        })
    }
}

/// Returns the properties of the scene that the page's rays ignore, as text for users, or `None` if there are
/// no such properties.
fn caveat(pvs: &Pvs, scene: Option<&Scene>, info: &Value) -> Option<String> {
    let has = |is: bool, what: &str| is.then(|| what.to_owned());
    let all = [
        has(
            scene.is_some_and(|scene| !scene.sides().are_both()),
            "that back faces are culled",
        ),
        has(
            scene.is_some_and(|scene| scene.kinds().any_masked()),
            "alpha textures",
        ),
        has(
            info["viewpoints"].is_object() && pvs.region().is_none(),
            "in which parts of a cell viewpoints are",
        ),
    ];
    let all: Vec<String> = all.into_iter().flatten().collect();
    (!all.is_empty()).then(|| all.join(" and "))
}

/// Computes a heat map with the result of `value` for each cell.
///
/// # Errors
/// The errors of `value`.
pub fn each(
    pvs: &Pvs,
    name: &str,
    value: impl Fn(&Pvs, u32) -> Result<f32, PvsError>,
) -> Result<Map, PvsError> {
    let values = (0..pvs.cells())
        .map(|cell| value(pvs, cell))
        .collect::<Result<_, _>>()?;
    Ok(Map {
        name: name.to_owned(),
        values,
    })
}

/// Returns the heat maps that can be computed for every result, without maps that are 0 everywhere.
fn maps(pvs: &Pvs) -> Result<Vec<Map>, PvsError> {
    let mut all = vec![
        each(pvs, "triangles in the set", |pvs, cell| {
            Ok(pvs.visible_count(cell)? as f32)
        })?,
        each(pvs, "undecided triangles", |pvs, cell| {
            Ok(pvs.undecided_count(cell)? as f32)
        })?,
        each(pvs, "bytes of the set", |pvs, cell| {
            Ok(pvs.visible_bytes(cell)?.own as f32)
        })?,
    ];
    all.retain(Map::says_something);
    Ok(all)
}

impl Map {
    /// Returns true if the map contains a number other than 0 and NaN.
    pub fn says_something(&self) -> bool {
        self.values.iter().any(|x| *x != 0.0 && !x.is_nan())
    }
}

/// Returns the cell with the median size of the visible set, among the cells with viewpoints.
fn median_cell(pvs: &Pvs) -> Result<CellIndex, PvsError> {
    let mut sizes = Vec::new();
    for cell in 0..pvs.cells() {
        if pvs.is_reached(cell)? {
            sizes.push((pvs.visible_count(cell)?, cell));
        }
    }
    sizes.sort_unstable();
    let middle = sizes.get(sizes.len() / 2);
    Ok(middle.map_or_else(CellIndex::default, |(_, cell)| CellIndex(*cell)))
}
