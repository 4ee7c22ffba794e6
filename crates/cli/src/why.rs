//! `sightline query --why`: the witness for a triangle visible from a cell, or the blockers that hide it.

use std::path::Path;

use glam::Vec3;
use serde_json::{Value, json};
use sightline_certificate::{CertificateReader, Proof, Reason, Target};
use sightline_exact::{
    Cell, Cost, ExactScene, Found, Hides, Limits, Places, Polygon, Sources, from_cell, polygon,
};
use sightline_portals::OpenFaces;
use sightline_pvs::Pvs;
use sightline_scene::{Aabb, Scene, overlap};

use crate::enclosure;
use crate::error::CliError;
use crate::opening;
use crate::serve::print;

/// Most blockers listed without --json.
const SHOWN: usize = 40;

/// Prints why a triangle is in a cell's set, or is not: from the result's certificates, or by a new query if
/// a scene is given.
pub fn why(
    pvs: &Pvs,
    result: &Path,
    (cell, triangle): (u32, u32),
    scene: Option<Scene>,
    json: bool,
) -> Result<(), CliError> {
    if triangle >= pvs.triangle_count() {
        return Err(CliError::Usage(format!(
            "there is no triangle {triangle}: {} was baked from a scene of {} triangles",
            result.display(),
            pvs.triangle_count()
        )));
    }
    let mut answer = match scene {
        Some(scene) => ask(pvs, result, &scene, (cell, triangle))?,
        None => look_up(pvs, result, cell, triangle)?,
    };
    if json {
        (answer["cell"], answer["triangle"]) = (cell.into(), triangle.into());
        return print(&answer.to_string());
    }
    let about = format!("triangle {triangle} from cell {cell}");
    let blockers = answer["blockers"].as_array().map_or(&[][..], |b| b);
    print(&match answer["state"].as_str() {
        Some("visible") if answer["meets"] == true => format!("{about}: visible, because it meets the cell"),
        Some("visible") => {
            format!(
                "{about}: visible along the segment from {} to {}, which crosses the triangle at its end and \
                 meets no other triangle before",
                answer["witness"][0], answer["witness"][1]
            )
        }
        Some("hidden") if answer["kind"].is_string() => {
            format!("{about}: in no set, because it is {}", answer["kind"].as_str().unwrap_or_default())
        }
        Some("hidden") if answer["degenerate"] == true => format!("{about}: hidden, because it has no area"),
        Some("hidden") if blockers.is_empty() => {
            format!(
                "{about}: hidden by the closed surface it belongs to, because its inner side faces the cell"
            )
        }
        Some("hidden") => {
            let with = match (answer["with"].as_u64(), answer["surface"] == true) {
                (Some(1), _) => " together with one other triangle".to_owned(),
                (Some(n @ 2..), _) => format!(" together with {n} other triangles"),
                (_, true) => {
                    " from one side by the closed surface it belongs to, from the other side".to_owned()
                }
                _ => String::new(),
            };
            let list: Vec<String> = blockers.iter().take(SHOWN).map(Value::to_string).collect();
            let more = match blockers.len().saturating_sub(SHOWN) {
                0 => String::new(),
                n => format!(" and {n} more (--json lists all)"),
            };
            let from = match answer["from"].as_array().map(Vec::as_slice) {
                Some([min, max]) => format!(", like from the whole box {min} to {max} around the cell,"),
                _ => String::new(),
            };
            format!("{about}: hidden{from}{with} by triangles {}{more}", list.join(" "))
        }
        _ => format!(
            "{about}: undecided{}; undecided triangles are in the set, so no visible one is missing",
            answer["reason"].as_str().map_or(String::new(), |r| format!(" ({r})"))
        ),
    })
}

/// The answer from the certificates of the result.
fn look_up(pvs: &Pvs, result: &Path, cell: u32, triangle: u32) -> Result<Value, CliError> {
    let found = CertificateReader::default()
        .read(pvs, cell)
        .map_err(|e| CliError::Input(format!("{}, cell {cell}: {e}", result.display())))?;
    let Some(certificates) = found else {
        return Err(CliError::Input(format!(
            "{} was baked without --certificates and stores no reasons; add --scene FILE for a new query",
            result.display()
        )));
    };
    let mut ids = Vec::new();
    pvs.undecided(cell, &mut ids)?;
    if ids.binary_search(&triangle).is_ok() {
        return Ok(json!({"state": "undecided", "reason": "add --scene for a new query"}));
    }
    pvs.visible(cell, &mut ids)?;
    Ok(match certificates.about(triangle) {
        Some((Reason::Seen(witness), _)) => json!({"state": "visible", "witness": witness.rounded()}),
        Some((Reason::Hidden(hidden), from)) => {
            let surface = matches!(hidden.target, Target::Surfaces | Target::Half);
            let with = match hidden.target {
                Target::Box(_) | Target::Polygon(_) => hidden.triangles.len() - 1,
                _ => 0,
            };
            let mut why = json!({
                "state": "hidden", "blockers": blockers(&hidden.proofs), "with": with, "surface": surface
            });
            if let Some(shared) = from {
                why["from"] = json!(shared.bounds.corners().map(|corner| corner.to_array()));
            }
            why
        }
        None if ids.binary_search(&triangle).is_ok() => json!({"state": "visible", "meets": true}),
        None => json!({"state": "hidden", "degenerate": true, "blockers": []}),
    })
}

/// The triangles that the occluders of these proofs consist of, ascending.
fn blockers(proofs: &[Proof]) -> Vec<u32> {
    let mut all: Vec<u32> = proofs.iter().flat_map(Proof::blockers).collect();
    all.sort_unstable();
    all.dedup();
    all
}

/// The answer of a new query in the scene.
pub fn ask(pvs: &Pvs, result: &Path, scene: &Scene, (cell, triangle): (u32, u32)) -> Result<Value, CliError> {
    if !scene.sides().are_both() {
        return Err(CliError::Input(format!(
            "{} was baked with --cull-back-faces, and exact queries take every triangle as seen from both \
             sides; --why answers for results without culling",
            result.display()
        )));
    }
    let kind = scene.kinds().kind(triangle);
    if !kind.shows() {
        return Ok(json!({"state": "hidden", "kind": kind.name(), "blockers": []}));
    }
    let bounds = pvs.cell_bounds(cell).unwrap_or_default().map(Vec3::from);
    let of = scene.triangles()[triangle as usize];
    let Some(target) = Polygon::triangle(of.v.map(|v| v.as_dvec3())) else {
        return Ok(json!({"state": "hidden", "degenerate": true, "blockers": []}));
    };
    let region = enclosure::of_result(pvs, scene, result)?;
    let places = region.as_ref().map(|region| region as &dyn Places);
    let within = Aabb { min: bounds[0], max: bounds[1] };
    let faces = enclosure::walls_of(pvs, scene).map(|scene| OpenFaces::new(scene, within, places));
    let places = faces.as_ref().map(|faces| faces as &dyn Places).or(places);
    if overlap::triangle_touches_box(&of, &within) && places.is_none_or(|p| p.touch(of.v, within)) {
        return Ok(json!({"state": "visible", "meets": true}));
    }
    opening::without_masks(scene)?;
    let view = Cell::new(bounds[0], bounds[1])
        .ok_or_else(|| CliError::Input(format!("cell {cell} has no volume; bake with larger cells")))?;
    let exact = ExactScene::prepare(scene)?;
    let meeting = overlap::triangles_in_box(scene, None, &Aabb { min: bounds[0], max: bounds[1] });
    let half = match exact.surfaces().seen_from(exact.occluders(), view, &meeting).hides(triangle) {
        Hides::All => return Ok(json!({"state": "hidden", "blockers": [], "surface": true})),
        Hides::From(side) => Some(side),
        Hides::Nothing => None,
    };
    Ok(
        match from_cell(
            exact.occluders(),
            &Sources::new(view, places),
            (&[target], half),
            (&Limits::default(), &|| false),
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
        },
    )
}
