//! Explanations of the visibility of triangles from a cell, from the certificates of a result or from new
//! queries.

use std::cell::OnceCell;
use std::path::Path;

use glam::Vec3;
use serde_json::{Value, json};
use sightline_certificate::{CertificateReader, Proof, Reason, Target};
use sightline_exact::{
    Cell, ExactScene, ExactViewRegion, FromCellAnswer, HiddenFrom, Occluders, Polygon, QueryCost,
    QueryLimits, Sources, from_cell, polygon,
};
use sightline_portals::OpenFaces;
use sightline_proto::v1;
use sightline_scene::{Aabb, Scene, TriangleId, overlap};
use sightline_viewcells::CellIndex;

use crate::error::Error;
use crate::observer::Observer;
use crate::result::{NamedResult, check_scene, without_masks};
use crate::viewpoints::{region_of_result, walls_of};

/// A function that receives the answer about a triangle. The function returns true to continue with the next
/// triangle.
pub type Each<'a> = dyn FnMut(TriangleId, Value) -> Result<bool, Error> + 'a;

/// Explains the visibility of a triangle from a cell. Returns the document that
/// `sightline query --why --json` prints: `state` is visible, hidden or undecided, with the witness, the
/// blockers or the reason. The answer comes from the certificates of the result, or from a new exact query if
/// a scene is given.
///
/// ```no_run
/// use sightline::{CellIndex, NamedResult, Silent, TriangleId};
///
/// let path = "level.pvs".as_ref();
/// let pvs = sightline::open(path)?;
/// let result = NamedResult::new(&pvs, path);
/// let answer = sightline::explain(result, None, CellIndex(0), TriangleId(17), &Silent)?;
/// println!("triangle 17 is {}", answer["state"]);
/// # Ok::<(), sightline::Error>(())
/// ```
///
/// # Errors
/// [`crate::ErrorKind::Usage`] if the cell or the triangle does not exist. [`crate::ErrorKind::Input`] if the
/// result has no certificates and no scene is given, if the scene is not the scene of the result, or if back
/// faces are culled. [`crate::ErrorKind::Cancelled`] if the observer cancels.
pub fn explain(
    result: NamedResult<'_>,
    scene: Option<&Scene>,
    cell: CellIndex,
    triangle: TriangleId,
    observer: &dyn Observer,
) -> Result<Value, Error> {
    let (cells, triangles) = (result.pvs.cells(), result.pvs.triangle_count());
    if cell.0 >= cells || triangle.0 >= triangles {
        return Err(Error::usage(format!(
            "cell {cell} or triangle {triangle} does not exist: {} has {cells} cells and {triangles} \
             triangles, numbered from 0",
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
            explain_by_query(result, scene, cell, &[triangle.0], &stop, &mut each)?;
            // The observer ended the query early, so the answer of the query is not valid.
            if observer.is_cancelled() {
                return Err(Error::cancelled(
                    "interrupted before the query had an answer",
                ));
            }
        }
        None => explain_by_certificates(result, cell, &[triangle.0], &mut each)?,
    }
    Ok(found)
}

/// Passes the answers that the certificates of a result contain about triangles to `each`.
///
/// # Errors
/// [`crate::ErrorKind::Input`] if the result has no certificates, or the errors of `each`.
pub fn explain_by_certificates(
    result: NamedResult<'_>,
    cell: CellIndex,
    triangles: &[u32],
    each: &mut Each<'_>,
) -> Result<(), Error> {
    let pvs = result.pvs;
    let found = CertificateReader::default()
        .read(pvs, cell.0)
        .map_err(|e| Error::input(format!("{}, cell {cell}: {e}", result.name.display())))?;
    let Some(certificates) = found else {
        return Err(Error::input(format!(
            "{} was baked without --certificates and stores no reasons; add --scene FILE for a new \
             query",
            result.name.display()
        )));
    };
    let (mut undecided, mut visible) = (Vec::new(), Vec::new());
    pvs.undecided(cell.0, &mut undecided)?;
    pvs.visible(cell.0, &mut visible)?;
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
        if !each(TriangleId(triangle), answer)? {
            break;
        }
    }
    Ok(())
}

/// Returns the triangles of the occluders of these proofs, ascending.
fn blockers(proofs: &[Proof]) -> Vec<u32> {
    let mut all: Vec<u32> = proofs.iter().flat_map(Proof::blockers).collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// Returns the answer of a new query as a message of the protocol.
///
/// # Errors
/// As for [`explain_by_query`].
pub fn explain_as_message(
    result: NamedResult<'_>,
    scene: &Scene,
    cell: CellIndex,
    triangle: TriangleId,
    stop: &dyn Fn() -> bool,
) -> Result<v1::WhyResponse, Error> {
    let mut answer = Value::Null;
    let mut each = |_, found| {
        answer = found;
        Ok(false)
    };
    explain_by_query(result, scene, cell, &[triangle.0], stop, &mut each)?;
    let list = |value: &Value| value.as_array().cloned().unwrap_or_default();
    let ends = list(&answer["witness"]);
    let number = |value: &Value| value.as_f64().map(|x| x as f32);
    let id = |value: &Value| value.as_u64().and_then(|id| u32::try_from(id).ok());
    let text = |key: &str| answer[key].as_str().unwrap_or_default().to_owned();
    Ok(v1::WhyResponse {
        cell: cell.0,
        state: text("state"),
        witness: ends
            .iter()
            .flat_map(list)
            .filter_map(|x| number(&x))
            .collect(),
        blockers: list(&answer["blockers"]).iter().filter_map(id).collect(),
        reason: match (answer["meets"] == true, answer["degenerate"] == true) {
            (true, _) => "the triangle meets the cell".to_owned(),
            (_, true) => "the triangle has no area".to_owned(),
            _ => [text("reason"), text("kind")].concat(),
        },
    })
}

/// Passes the answers of new queries in the scene to `each`. A query ends undecided if `stop` returns true.
///
/// # Errors
/// [`crate::ErrorKind::Input`] if exact queries cannot read the scene, or the errors of `each`.
pub fn explain_by_query(
    result: NamedResult<'_>,
    scene: &Scene,
    cell: CellIndex,
    triangles: &[u32],
    stop: &dyn Fn() -> bool,
    each: &mut Each<'_>,
) -> Result<(), Error> {
    if !scene.sides().are_both() {
        return Err(Error::input(format!(
            "{} was baked with --cull-back-faces, but exact queries use both sides of every \
             triangle; use --why only with a result that was baked without --cull-back-faces",
            result.name.display()
        )));
    }
    let [min, max] = result
        .pvs
        .cell_bounds(cell.0)
        .unwrap_or_default()
        .map(Vec3::from);
    let within = Aabb { min, max };
    let planes = region_of_result(result, scene)?;
    let region = planes.as_ref().map(|planes| planes as &dyn ExactViewRegion);
    let faces = walls_of(result, scene).map(|scene| OpenFaces::new(scene, within, region));
    let region = faces
        .as_ref()
        .map(|faces| faces as &dyn ExactViewRegion)
        .or(region);
    // Many answers need no query, and the preparation takes a while, so prepare on demand.
    let (exact, surfaces) = (OnceCell::new(), OnceCell::new());
    for triangle in triangles.iter().copied() {
        let kind = scene.kinds().kind(TriangleId(triangle));
        let shape = scene.triangles()[triangle as usize];
        let answer = match Polygon::triangle(shape.v.map(|v| v.as_dvec3())) {
            _ if !kind.shows() => json!({"state": "hidden", "kind": kind.name(), "blockers": []}),
            None => json!({"state": "hidden", "degenerate": true, "blockers": []}),
            Some(_)
                if overlap::triangle_touches_box(&shape, &within)
                    && region.is_none_or(|region| region.touch(shape.v, within)) =>
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
                let sources = Sources::new(view, region);
                queried(
                    exact.occluders(),
                    &sources,
                    target,
                    turned_away.hides(triangle),
                    stop,
                )
            }
        };
        if !each(TriangleId(triangle), answer)? {
            break;
        }
    }
    Ok(())
}

/// Returns the answer of one query about a triangle. `turned_away` are the sides of the triangle that its
/// closed surface hides from the cell.
fn queried(
    occluders: &Occluders,
    sources: &Sources<'_>,
    target: Polygon,
    turned_away: HiddenFrom,
    stop: &dyn Fn() -> bool,
) -> Value {
    let half = match turned_away {
        HiddenFrom::All => return json!({"state": "hidden", "blockers": [], "surface": true}),
        HiddenFrom::From(side) => Some(side),
        HiddenFrom::Nothing => None,
    };
    match from_cell(
        occluders,
        sources,
        &[target],
        half,
        &QueryLimits::default(),
        stop,
        &mut QueryCost::default(),
    ) {
        FromCellAnswer::Visible(ends) => {
            let witness = ends.each_ref().map(|e| polygon::rounded(e).to_array());
            json!({"state": "visible", "witness": witness})
        }
        FromCellAnswer::Hidden(proofs) => {
            json!({"state": "hidden", "blockers": blockers(&proofs), "surface": half.is_some()})
        }
        FromCellAnswer::Undecided(reason) => {
            json!({"state": "undecided", "reason": reason.to_string()})
        }
    }
}
