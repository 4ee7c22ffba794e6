//! Why triangles are visible from a cell or hidden: the reasons that a result keeps, or those of new queries.

use std::cell::OnceCell;
use std::path::Path;

use glam::Vec3;
use serde_json::{Value, json};
use sightline_certificate::{CertificateReader, Proof, Reason, Target};
use sightline_exact::{
    Cell, Cost, ExactScene, Found, Hides, Limits, Occluders, Places, Polygon, Sources, from_cell,
    polygon,
};
use sightline_portals::OpenFaces;
use sightline_proto::v1;
use sightline_pvs::Pvs;
use sightline_scene::{Aabb, Scene, overlap};

use crate::enclosure;
use crate::error::CliError;
use crate::opening;

/// Takes the answer about a triangle, and says whether to go on to the next.
pub type Each<'a> = dyn FnMut(u32, Value) -> Result<bool, CliError> + 'a;

/// The answers that the certificates of a result keep about triangles.
pub fn keep_each(
    pvs: &Pvs,
    result: &Path,
    cell: u32,
    triangles: &[u32],
    each: &mut Each<'_>,
) -> Result<(), CliError> {
    let found = CertificateReader::default()
        .read(pvs, cell)
        .map_err(|e| CliError::Input(format!("{}, cell {cell}: {e}", result.display())))?;
    let Some(certificates) = found else {
        return Err(CliError::Input(format!(
            "{} was baked without --certificates and stores no reasons; add --scene FILE for a new query",
            result.display()
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

/// The triangles that the occluders of these proofs consist of, ascending.
fn blockers(proofs: &[Proof]) -> Vec<u32> {
    let mut all: Vec<u32> = proofs.iter().flat_map(Proof::blockers).collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// Returns the answer of a new query in the scene, which ends undecided when `stop` is true.
pub fn ask(
    pvs: &Pvs,
    result: &Path,
    scene: &Scene,
    (cell, triangle): (u32, u32),
    stop: &dyn Fn() -> bool,
) -> Result<Value, CliError> {
    let mut found = Value::Null;
    let mut each = |_, answer| {
        found = answer;
        Ok(false)
    };
    ask_each(pvs, result, scene, (cell, &[triangle]), stop, &mut each)?;
    Ok(found)
}

/// The same as a message of the protocol.
pub fn ask_as_message(
    pvs: &Pvs,
    result: &Path,
    scene: &Scene,
    (cell, triangle): (u32, u32),
    stop: &dyn Fn() -> bool,
) -> Result<v1::WhyResponse, CliError> {
    let answer = ask(pvs, result, scene, (cell, triangle), stop)?;
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

/// Answers new queries in the scene, which end undecided when `stop` is true.
pub fn ask_each(
    pvs: &Pvs,
    result: &Path,
    scene: &Scene,
    (cell, triangles): (u32, &[u32]),
    stop: &dyn Fn() -> bool,
    each: &mut Each<'_>,
) -> Result<(), CliError> {
    if !scene.sides().are_both() {
        return Err(CliError::Input(format!(
            "{} was baked with --cull-back-faces, and exact queries take every triangle as seen from both \
             sides; --why answers for results without culling",
            result.display()
        )));
    }
    let [min, max] = pvs.cell_bounds(cell).unwrap_or_default().map(Vec3::from);
    let within = Aabb { min, max };
    let region = enclosure::of_result(pvs, scene, result)?;
    let places = region.as_ref().map(|region| region as &dyn Places);
    let faces = enclosure::walls_of(pvs, scene).map(|scene| OpenFaces::new(scene, within, places));
    let places = faces.as_ref().map(|faces| faces as &dyn Places).or(places);
    // Many answers need no query, and preparing them takes a while.
    let (exact, surfaces) = (OnceCell::new(), OnceCell::new());
    for triangle in triangles.iter().copied() {
        let kind = scene.kinds().kind(triangle);
        let of = scene.triangles()[triangle as usize];
        let answer = match Polygon::triangle(of.v.map(|v| v.as_dvec3())) {
            _ if !kind.shows() => json!({"state": "hidden", "kind": kind.name(), "blockers": []}),
            None => json!({"state": "hidden", "degenerate": true, "blockers": []}),
            Some(_)
                if overlap::triangle_touches_box(&of, &within)
                    && places.is_none_or(|p| p.touch(of.v, within)) =>
            {
                json!({"state": "visible", "meets": true})
            }
            Some(target) => {
                opening::without_masks(scene)?;
                let view = Cell::new(min, max).ok_or_else(|| {
                    CliError::Input(format!("cell {cell} has no volume; bake with larger cells"))
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

/// The answer of one query about a triangle of which the closed surface it belongs to hides `turned_away`.
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
