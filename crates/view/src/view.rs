//! What a page shows of any result: the heat maps that every result has, and where to begin.

use serde_json::Value;
use sightline_pvs::{Pvs, PvsError};
use sightline_scene::Scene;

use crate::{Map, View};

impl<'a> View<'a> {
    /// A page with what is in a result alone, without words about it.
    ///
    /// # Errors
    /// [`PvsError`] when the result cannot be read.
    pub fn of(pvs: &'a Pvs, scene: Option<&'a Scene>) -> Result<Self, PvsError> {
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
            start: middling(pvs)?,
            nonce: String::new(),
        })
    }
}

/// What rays in the page do not know.
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

/// A number of each cell.
///
/// # Errors
/// Those of `of`.
pub fn each(
    pvs: &Pvs,
    name: &str,
    of: impl Fn(&Pvs, u32) -> Result<f32, PvsError>,
) -> Result<Map, PvsError> {
    let values = (0..pvs.cells())
        .map(|cell| of(pvs, cell))
        .collect::<Result<_, _>>()?;
    Ok(Map {
        name: name.to_owned(),
        values,
    })
}

/// The heat maps that every result has numbers for.
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
    /// Whether it has a number other than 0.
    pub fn says_something(&self) -> bool {
        self.values.iter().any(|x| *x != 0.0 && !x.is_nan())
    }
}

/// The cell with viewpoints whose set is neither large nor small.
fn middling(pvs: &Pvs) -> Result<u32, PvsError> {
    let mut sizes = Vec::new();
    for cell in 0..pvs.cells() {
        if pvs.is_reached(cell)? {
            sizes.push((pvs.visible_count(cell)?, cell));
        }
    }
    sizes.sort_unstable();
    Ok(sizes.get(sizes.len() / 2).map_or(0, |(_, cell)| *cell))
}
