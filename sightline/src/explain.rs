//! Reasons why triangles are visible from a cell or hidden: the reasons that a result stores, or new queries.

use std::cell::OnceCell;
use std::path::Path;

use glam::Vec3;
use serde_json::{Value, json};
use sightline_certificate::{CertificateReader, Proof, Reason, Target};
use sightline_exact::{
    Cell, Cost, ExactScene, ExactViewRegion, Found, Hides, Limits, Occluders, Polygon, Sources,
    from_cell, polygon,
};
use sightline_portals::OpenFaces;
use sightline_proto::v1;
use sightline_scene::{Aabb, Scene, overlap};

use crate::error::Error;
use crate::observer::Observer;
use crate::result::{NamedResult, check_scene, without_masks};
use crate::viewpoints::{region_of_result, walls_of};

/// A function that receives the answer about a triangle, and returns true to continue with the next one.
pub type Each<'a> = dyn FnMut(u32, Value) -> Result<bool, Error> + 'a;

/// Explains why a triangle is visible from a cell or hidden; returns the document that
/// `sightline query --why --json` prints: `state` is visible, hidden or undecided, with the witness, the
/// blockers or the reason. The certificates of the result answer, or, with a scene, a new exact query.
///
/// ```no_run
/// use sightline::{NamedResult, Silent};
///
/// let path = "level.pvs".as_ref();
/// let pvs = sightline::open(path)?;
/// let answer = sightline::explain(NamedResult::new(&pvs, path), None, (0, 17), &Silent)?;
/// println!("triangle 17 is {}", answer["state"]);
/// # Ok::<(), sightline::Error>(())
/// ```
///
/// # Errors
/// [`crate::ErrorKind::Usage`] for a cell or triangle that does not exist, [`crate::ErrorKind::Input`] for a
/// result without certificates, if there is no scene, for another scene than that of the result, and for
/// scenes with culled back faces; [`crate::ErrorKind::Cancelled`].
pub fn explain(
    result: NamedResult<'_>,
    scene: Option<&Scene>,
    (cell, triangle): (u32, u32),
    observer: &dyn Observer,
) -> Result<Value, Error> {
    let (cells, triangles) = (result.pvs.cells(), result.pvs.triangle_count());
    if cell >= cells || triangle >= triangles {
        return Err(Error::usage(format!(
            "{} has {cells} cells and {triangles} triangles, numbered from 0; there is no triangle \
             {triangle} or no cell {cell}",
            result.name.display()
        )));
    }
    let mut found = Value::Null;
    let mut each = |_, answer| {
        found = answer;
        Ok(false)
    };
    match scene {
        Some(scene) => {
            check_scene(scene, Path::new("the scene"), result)?;
            let stop = || observer.is_cancelled();
            explain_by_query(result, scene, (cell, &[triangle]), &stop, &mut each)?;
            // The query ended early, so its answer is not one.
            if observer.is_cancelled() {
                return Err(Error::cancelled("interrupted; nothing is known yet"));
            }
        }
        None => explain_by_certificates(result, (cell, &[triangle]), &mut each)?,
    }
    Ok(found)
}

/// Gives `each` the answers that the certificates of a result store about triangles.
///
/// # Errors
/// [`crate::ErrorKind::Input`] for a result without certificates, and the errors of `each`.
pub fn explain_by_certificates(
    result: NamedResult<'_>,
    (cell, triangles): (u32, &[u32]),
    each: &mut Each<'_>,
) -> Result<(), Error> {
    let pvs = result.pvs;
    let found = CertificateReader::default()
        .read(pvs, cell)
        .map_err(|e| Error::input(format!("{}, cell {cell}: {e}", result.name.display())))?;
    let Some(certificates) = found else {
        return Err(Error::input(format!(
            "{} was baked without --certificates and stores no reasons; add --scene FILE for a new query",
            result.name.display()
        )));
    };
    let (mut undecided, mut visible) = (Vec::new(), Vec::new());
    pvs.undecided(cell, &mut undecided)?;
    pvs.visible(cell, &mut visible)?;
    for triangle in triangles.iter().copied() {
        let answer = match certificates.about(triangle) {
            _ if undecided.binary_search(&triangle).is_ok() => {
                json!({"state": "undecided", "reason": "add --scene for a new query"})
            }
            Some((Reason::Seen(witness), _)) => {
                json!({"state": "visible", "witness": witness.rounded()})
            }
            Some((Reason::Hidden(hidden), from)) => {
                let surface = matches!(hidden.target, Target::Surfaces | Target::Half);
                let with = match hidden.target {
                    Target::Box(_) | Target::Polygon(_) => hidden.triangles.len() - 1,
                    _ => 0,
                };
                let mut why = json!({
                    "state": "hidden", "blockers": blockers(&hidden.proofs), "with": with,
                    "surface": surface
                });
                if let Some(shared) = from {
                    why["from"] = json!(shared.bounds.corners().map(|corner| corner.to_array()));
                }
                why
            }
            None if visible.binary_search(&triangle).is_ok() => {
                json!({"state": "visible", "meets": true})
            }
            None => {
                json!({"state": "hidden", "kind": "without area, or does not show", "blockers": []})
            }
        };
        if !each(triangle, answer)? {
            break;
        }
    }
    Ok(())
}

/// Returns the triangles that the occluders of these proofs consist of, ascending.
fn blockers(proofs: &[Proof]) -> Vec<u32> {
    let mut all: Vec<u32> = proofs.iter().flat_map(Proof::blockers).collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// Returns the answer of a new query as a message of the protocol.
///
/// # Errors
/// As [`explain_by_query`].
pub fn explain_as_message(
    result: NamedResult<'_>,
    scene: &Scene,
    (cell, triangle): (u32, u32),
    stop: &dyn Fn() -> bool,
) -> Result<v1::WhyResponse, Error> {
    let mut answer = Value::Null;
    let mut each = |_, found| {
        answer = found;
        Ok(false)
    };
    explain_by_query(result, scene, (cell, &[triangle]), stop, &mut each)?;
    let list = |value: &Value| value.as_array().cloned().unwrap_or_default();
    let ends = list(&answer["witness"]);
    let number = |value: &Value| value.as_f64().map(|x| x as f32);
    let id = |value: &Value| value.as_u64().and_then(|id| u32::try_from(id).ok());
    let text = |key: &str| answer[key].as_str().unwrap_or_default().to_owned();
    Ok(v1::WhyResponse {
        cell,
        state: text("state"),
        witness: ends
            .iter()
            .flat_map(list)
            .filter_map(|x| number(&x))
            .collect(),
        blockers: list(&answer["blockers"]).iter().filter_map(id).collect(),
        reason: match (answer["meets"] == true, answer["degenerate"] == true) {
            (true, _) => "it meets the cell".to_owned(),
            (_, true) => "it has no area".to_owned(),
            _ => [text("reason"), text("kind")].concat(),
        },
    })
}

/// Gives `each` the answers of new queries in the scene, which end undecided when `stop` returns true.
///
/// # Errors
/// [`crate::ErrorKind::Input`] for scenes that exact queries cannot read, and the errors of `each`.
pub fn explain_by_query(
    result: NamedResult<'_>,
    scene: &Scene,
    (cell, triangles): (u32, &[u32]),
    stop: &dyn Fn() -> bool,
    each: &mut Each<'_>,
) -> Result<(), Error> {
    if !scene.sides().are_both() {
        return Err(Error::input(format!(
            "{} was baked with --cull-back-faces, and exact queries take every triangle as seen from both \
             sides; --why answers for results without culling",
            result.name.display()
        )));
    }
    let [min, max] = result
        .pvs
        .cell_bounds(cell)
        .unwrap_or_default()
        .map(Vec3::from);
    let within = Aabb { min, max };
    let region = region_of_result(result, scene)?;
    let places = region.as_ref().map(|region| region as &dyn ExactViewRegion);
    let faces = walls_of(result, scene).map(|scene| OpenFaces::new(scene, within, places));
    let places = faces
        .as_ref()
        .map(|faces| faces as &dyn ExactViewRegion)
        .or(places);
    // Many answers need no query, and preparing them takes a while.
    let (exact, surfaces) = (OnceCell::new(), OnceCell::new());
    for triangle in triangles.iter().copied() {
        let kind = scene.kinds().kind(triangle);
        let shape = scene.triangles()[triangle as usize];
        let answer = match Polygon::triangle(shape.v.map(|v| v.as_dvec3())) {
            _ if !kind.shows() => json!({"state": "hidden", "kind": kind.name(), "blockers": []}),
            None => json!({"state": "hidden", "degenerate": true, "blockers": []}),
            Some(_)
                if overlap::triangle_touches_box(&shape, &within)
                    && places.is_none_or(|p| p.touch(shape.v, within)) =>
            {
                json!({"state": "visible", "meets": true})
            }
            Some(target) => {
                without_masks(scene)?;
                let view = Cell::new(min, max).ok_or_else(|| {
                    Error::input(format!("cell {cell} has no volume; bake with larger cells"))
                })?;
                let exact = match exact.get() {
                    Some(exact) => exact,
                    None => {
                        let prepared = ExactScene::prepare(scene)?;
                        exact.get_or_init(|| prepared)
                    }
                };
                let turned_away = surfaces.get_or_init(|| {
                    let meeting = overlap::triangles_in_box(scene, None, &within);
                    exact
                        .surfaces()
                        .seen_from(exact.occluders(), view, &meeting)
                });
                let sources = Sources::new(view, places);
                queried(
                    exact.occluders(),
                    &sources,
                    target,
                    turned_away.hides(triangle),
                    stop,
                )
            }
        };
        if !each(triangle, answer)? {
            break;
        }
    }
    Ok(())
}

/// Returns the answer of one query about a triangle whose closed surface hides the sides `turned_away`.
fn queried(
    occluders: &Occluders,
    sources: &Sources<'_>,
    target: Polygon,
    turned_away: Hides,
    stop: &dyn Fn() -> bool,
) -> Value {
    let half = match turned_away {
        Hides::All => return json!({"state": "hidden", "blockers": [], "surface": true}),
        Hides::From(side) => Some(side),
        Hides::Nothing => None,
    };
    match from_cell(
        occluders,
        sources,
        (&[target], half),
        (&Limits::default(), stop),
        &mut Cost::default(),
    ) {
        Found::Visible(ends) => {
            let witness = ends.each_ref().map(|e| polygon::rounded(e).to_array());
            json!({"state": "visible", "witness": witness})
        }
        Found::Hidden(proofs) => {
            json!({"state": "hidden", "blockers": blockers(&proofs), "surface": half.is_some()})
        }
        Found::Undecided(reason) => json!({"state": "undecided", "reason": reason.to_string()}),
    }
}
