//! `sightline query --why`: prints the witness for a triangle or an object that is visible from a cell, or
//! the blockers that hide it. The output is text, JSON or a picture.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

use glam::Vec3;
use serde_json::{Value, json};
use sightline::output::{Format, Output};
use sightline::tracers::open_tracer;
use sightline::words::plural;
use sightline::{CellIndex, Error};
use sightline::{Each, NamedResult, explain_by_certificates, explain_by_query};
use sightline_measure::Portrait;
use sightline_model::TracerChoice;
use sightline_pvs::Pvs;
use sightline_scene::{Scene, SurfaceKind};
use sightline_trace::sight::{SightLineTracer, least_step};
use sightline_trace::{CubeSpec, PreparedScene, Strata};

use crate::results::query_target::{OBJECT, QueryTarget};
use crate::terminal::printable;
use crate::terminal::progress::Terminal;
use crate::terminal::stdout::print;

/// Maximum number of blockers that are listed without --json.
const SHOWN: usize = 40;

/// A query with its result and its options.
pub struct Question<'a> {
    pub pvs: &'a Pvs,
    /// The path of the result's file, for errors.
    pub result: &'a Path,
    pub cell: CellIndex,
    pub what: &'a QueryTarget,
    /// The scene for new queries. Without it, the result's certificates answer.
    pub scene: Option<Arc<Scene>>,
    /// The position of the viewer in the cell.
    pub eye: [f32; 3],
    /// The path of the picture to write.
    pub picture: Option<&'a Path>,
}

/// Prints the reason why a cell's set contains a triangle or an object, or does not. The reason comes from
/// the result's certificates, or from new queries if a scene is given.
pub fn why(question: &Question<'_>, json: bool) -> Result<(), Error> {
    let pvs = question.pvs;
    let picture_to = match question.picture {
        Some(path) => Some(Output::check(path, Format::Png, Some(question.result))?),
        None => None,
    };
    let (about, triangles, mut answer) = match question.what {
        QueryTarget::Triangle(triangle) => {
            if triangle.0 >= pvs.triangle_count() {
                return Err(Error::usage(format!(
                    "there is no triangle {triangle}: {} was baked from a scene of {} triangles, \
                     numbered from 0",
                    question.result.display(),
                    pvs.triangle_count()
                )));
            }
            let mut answer = Value::Null;
            question.each(&[triangle.0], &mut |_, found| {
                answer = found;
                Ok(false)
            })?;
            answer["triangle"] = triangle.0.into();
            (format!("triangle {triangle}"), vec![triangle.0], answer)
        }
        QueryTarget::Object(name) => {
            let index = object(question, name)?;
            let entry = &pvs.objects()[index];
            let triangles: Vec<u32> =
                (entry.first..entry.first.saturating_add(entry.count)).collect();
            let mut answer = of_object(question, &triangles)?;
            (answer["object"], answer["name"]) = (index.into(), entry.name.as_str().into());
            (
                format!("object {}", printable::name(&entry.name)),
                triangles,
                answer,
            )
        }
    };
    answer["cell"] = question.cell.0.into();
    answer["asked"] = question.scene.is_some().into();
    if let (Some(path), Some(picture_to)) = (question.picture, &picture_to) {
        draw(question, &triangles, &answer, path, picture_to)?;
        answer["picture"] = path.display().to_string().into();
    }
    if json {
        return print(&answer.to_string());
    }
    print(&in_words(
        &format!("{about} from cell {}", question.cell),
        &answer,
    ))?;
    question
        .picture
        .map_or(Ok(()), |path| print(&format!("wrote {}", path.display())))
}

impl Question<'_> {
    fn each(&self, triangles: &[u32], each: &mut Each<'_>) -> Result<(), Error> {
        let result = NamedResult::new(self.pvs, self.result);
        match &self.scene {
            Some(scene) => explain_by_query(result, scene, self.cell, triangles, &|| false, each),
            None => explain_by_certificates(result, self.cell, triangles, each),
        }
    }
}

/// Returns the number of the object with this name or number.
fn object(question: &Question<'_>, name: &str) -> Result<usize, Error> {
    let objects = question.pvs.objects();
    let named: Vec<usize> = (0..objects.len())
        .filter(|i| objects[*i].name == name)
        .collect();
    let number = name.parse().ok().filter(|i: &usize| *i < objects.len());
    match (&named[..], number) {
        ([one], _) => Ok(*one),
        ([], Some(number)) => Ok(number),
        ([], None) => Err(Error::usage(format!(
            "{} has no object {name:?}; `sightline info --json` lists its {}",
            question.result.display(),
            plural(objects.len(), "object")
        ))),
        ([first, .., last], _) => Err(Error::usage(format!(
            "{} objects have the name {name:?}, the first is {OBJECT}{first} and the last {OBJECT}{last}; \
             give one of these numbers",
            named.len()
        ))),
    }
}

/// Explains the visibility of an object, which is visible if one of its triangles is visible.
fn of_object(question: &Question<'_>, triangles: &[u32]) -> Result<Value, Error> {
    let mut set = Vec::new();
    question.pvs.visible(question.cell.0, &mut set)?;
    // Triangles in the set come first: if the object is visible, one of them is visible.
    let (mut order, others): (Vec<u32>, Vec<u32>) =
        triangles.iter().partition(|t| set.binary_search(t).is_ok());
    order.extend(others);
    let progress = Terminal::new();
    let (mut blockers, mut undecided, mut reasons) = (Vec::new(), Vec::new(), BTreeSet::new());
    let (mut hidden, mut seen) = (0u64, None);
    let asked = question.each(&order, &mut |triangle, mut answer| {
        match answer["state"].as_str() {
            Some("visible") => {
                answer["triangle"] = triangle.0.into();
                seen = Some(answer);
                return Ok(false);
            }
            Some("hidden") => {
                hidden += 1;
                let triangle_blockers = answer["blockers"].as_array().map_or(&[][..], |b| b);
                blockers.extend(triangle_blockers.iter().filter_map(Value::as_u64));
                reasons.insert(
                    match (answer["kind"].as_str(), answer["degenerate"] == true) {
                        (Some(kind), _) => format!("are {}", kind_text(kind)),
                        (None, true) => "have no area".to_owned(),
                        (None, false) if triangle_blockers.is_empty() => {
                            "turn their inner side to the cell".to_owned()
                        }
                        (None, false) => "are behind others".to_owned(),
                    },
                );
            }
            _ => undecided.push(triangle),
        }
        progress.count(
            hidden + undecided.len() as u64,
            order.len() as u64,
            "triangles",
        );
        Ok(true)
    });
    progress.end();
    asked?;
    if let Some(seen) = seen {
        return Ok(seen);
    }
    blockers.sort_unstable();
    blockers.dedup();
    let state = if undecided.is_empty() {
        "hidden"
    } else {
        "undecided"
    };
    Ok(json!({
        "state": state, "blockers": blockers, "triangles": order.len(), "undecided": undecided,
        "reasons": reasons,
    }))
}

/// Formats the answer about a triangle or an object as a sentence that begins with `about`.
fn in_words(about: &str, answer: &Value) -> String {
    let blockers = answer["blockers"].as_array().map_or(&[][..], |b| b);
    // For a visible object, the answer names one visible triangle.
    let of_object = answer["triangle"]
        .as_u64()
        .filter(|_| answer["object"].is_u64())
        .map(|t| format!("its triangle {t}"));
    let one = |of_triangle: &str| of_object.clone().unwrap_or_else(|| of_triangle.to_owned());
    match answer["state"].as_str() {
        Some("visible") if answer["meets"] == true => {
            format!("{about}: visible, because {} meets the cell", one("it"))
        }
        Some("visible") => {
            format!(
                "{about}: visible along the segment from {} to {}, which crosses {} at its end and meets no \
                 other triangle before",
                answer["witness"][0],
                answer["witness"][1],
                one("the triangle")
            )
        }
        Some("hidden") if answer["triangles"] == 0 => {
            format!("{about}: in no set, because it has no triangles")
        }
        Some("hidden") if answer["object"].is_u64() => {
            let reasons = answer["reasons"].as_array().map_or(&[][..], |r| r);
            let reasons: Vec<&str> = reasons.iter().filter_map(Value::as_str).collect();
            let behind = match blockers {
                [] => String::new(),
                _ => format!("; the triangles in front of them are {}", listed(blockers)),
            };
            format!(
                "{about}: hidden, because all its triangles {}{behind}",
                reasons.join(" or ")
            )
        }
        Some("hidden") if answer["kind"].is_string() => {
            let kind = kind_text(answer["kind"].as_str().unwrap_or_default());
            format!("{about}: in no set, because it is {kind}")
        }
        Some("hidden") if answer["degenerate"] == true => {
            format!("{about}: hidden, because it has no area")
        }
        Some("hidden") if blockers.is_empty() => {
            format!(
                "{about}: hidden by its own closed surface, because its inner side faces the cell"
            )
        }
        Some("hidden") => {
            let with = match (answer["with"].as_u64(), answer["surface"] == true) {
                (Some(1), _) => " together with one other triangle".to_owned(),
                (Some(n @ 2..), _) => format!(" together with {n} other triangles"),
                (_, true) => {
                    " from one side by its own closed surface, from the other side".to_owned()
                }
                _ => String::new(),
            };
            let from = match answer["from"].as_array().map(Vec::as_slice) {
                Some([min, max]) => {
                    format!(", as from the whole box {min} to {max} around the cell,")
                }
                _ => String::new(),
            };
            format!(
                "{about}: hidden{from}{with} by triangles {}",
                listed(blockers)
            )
        }
        _ if answer["object"].is_u64() => {
            let open = answer["undecided"].as_array().map_or(&[][..], |u| u);
            format!(
                "{about}: undecided, because triangles {} are{}; undecided triangles are in the set, so no \
                 visible one is missing",
                listed(open),
                if answer["asked"] == true {
                    ""
                } else {
                    " (add --scene for new queries)"
                }
            )
        }
        _ => format!(
            "{about}: undecided{}; undecided triangles are in the set, so no visible one is \
             missing",
            answer["reason"]
                .as_str()
                .map_or(String::new(), |r| format!(" ({r})"))
        ),
    }
}

/// Returns the text for a kind of triangles that are in no set.
fn kind_text(name: &str) -> &str {
    match SurfaceKind::from_name(name) {
        Some(SurfaceKind::Hidden) => "switched off by the scene's file (KHR_node_visibility)",
        _ => name,
    }
}

/// Formats the numbers of triangles, at most the first 40.
fn listed(triangles: &[Value]) -> String {
    let list: Vec<String> = triangles.iter().take(SHOWN).map(Value::to_string).collect();
    match triangles.len().saturating_sub(SHOWN) {
        0 => list.join(" "),
        n => format!("{} and {n} more (--json lists all)", list.join(" ")),
    }
}

/// Draws an answer from a point that sees the target, or otherwise from the viewpoint.
fn draw(
    question: &Question<'_>,
    target: &[u32],
    answer: &Value,
    path: &Path,
    picture_to: &Output,
) -> Result<(), Error> {
    let Some(scene) = &question.scene else {
        return Err(Error::usage(
            "--picture needs the scene; give --scene".to_owned(),
        ));
    };
    let end = |k: usize| {
        let at = |axis: usize| answer["witness"][k][axis].as_f64().map(|x| x as f32);
        Some(Vec3::new(at(0)?, at(1)?, at(2)?))
    };
    let blockers = answer["blockers"].as_array().map_or(&[][..], |b| b);
    let blockers: Vec<u32> = blockers
        .iter()
        .filter_map(|b| u32::try_from(b.as_u64()?).ok())
        .collect();
    let info: Value = serde_json::from_str(question.pvs.info_json()).unwrap_or_default();
    let scene = Arc::clone(scene);
    let spec = CubeSpec {
        resolution: 8,
        strata: Strata::One,
        keep_pixels: false,
    };
    let (_, backend) = open_tracer(TracerChoice::Auto, &scene, spec, &Terminal::new())?;
    let step = least_step(scene.bounds());
    let prepared = PreparedScene::new(Arc::clone(&scene))?;
    let sight = SightLineTracer::new(&*backend, prepared.traced()).map_err(Error::internal)?;
    let portrait = Portrait {
        eye: end(0).unwrap_or_else(|| question.eye.into()),
        target,
        blockers: &blockers,
        seen_at: end(1),
        vertical: if info["spec"]["visibility"]["up"] == "z" {
            Vec3::Z
        } else {
            Vec3::Y
        },
    };
    let picture = portrait
        .draw(&scene, &sight, step)
        .map_err(Error::internal)?;
    picture_to.write(|out| {
        out.write_all(&picture)
            .map_err(|e| Error::writing(path, &e))
    })
}
