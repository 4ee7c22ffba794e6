//! Opening scenes and results, and checking that a result was baked from a given scene.

use std::path::Path;

use sightline_pvs::{Pvs, PvsError};
use sightline_scene::kinds::{Kind, KindCount};
use sightline_scene::{Rule, Scene};

use crate::error::CliError;
use crate::progress::say;

/// A number with its noun, in the plural unless the number is 1.
pub fn plural(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

/// Opens a result; the error names the file.
pub fn open(path: &Path) -> Result<Pvs, CliError> {
    Pvs::open(path).map_err(|e| match e {
        PvsError::Open { .. } => CliError::Input(format!("{e}; name a file that `sightline bake` wrote")),
        e => CliError::Input(format!("{}: {e}", path.display())),
    })
}

/// Reads a scene with the rules of the user, and prints the warnings.
pub fn scene(path: &Path, rules: &[Rule]) -> Result<Scene, CliError> {
    let options = sightline_scene::load::Options { rules: rules.to_vec(), ..Default::default() };
    let loaded = sightline_scene::load_with(path, &options)?;
    loaded.warnings.iter().for_each(|w| say(&format!("warning: {}: {w}", path.display())));
    Ok(loaded.scene)
}

/// Reads the scene of a result: with the rules of the user, or else with those that the result was baked
/// with.
pub fn scene_of(path: &Path, rules: &[Rule], pvs: &Pvs, result: &Path) -> Result<Scene, CliError> {
    let scene =
        if rules.is_empty() { self::scene(path, &rules_of(pvs, result)?)? } else { scene(path, rules)? };
    check_scene(&scene, pvs, path, result)?;
    Ok(scene)
}

/// The rules that a result was baked with.
fn rules_of(pvs: &Pvs, result: &Path) -> Result<Vec<Rule>, CliError> {
    let info: serde_json::Value = serde_json::from_str(pvs.info_json()).unwrap_or_default();
    let rules = info["kinds"]["rules"].as_array().map_or(&[][..], |r| r);
    let rule =
        |r: &serde_json::Value| Rule::new(Kind::from_name(r["kind"].as_str()?)?, r["glob"].as_str()?).ok();
    rules
        .iter()
        .map(|r| {
            rule(r).ok_or_else(|| {
                CliError::Input(format!(
                    "{}: it names a rule about kinds that is none: {r}",
                    result.display()
                ))
            })
        })
        .collect()
}

/// The counts of kinds in the description of a result.
pub fn counts_of(info: &serde_json::Value) -> Vec<KindCount> {
    let counts = info["kinds"]["counts"].as_array().map_or(&[][..], |c| c);
    let count = |c: &serde_json::Value| {
        Some(KindCount {
            kind: Kind::from_name(c["kind"].as_str()?)?,
            reason: c["reason"].as_str()?.to_owned(),
            triangles: c["triangles"].as_u64()?,
        })
    };
    counts.iter().filter_map(count).collect()
}

/// The kinds of a scene in words, one line each.
pub fn kinds_in_words(counts: &[KindCount]) -> Vec<String> {
    if counts.is_empty() {
        return vec!["all triangles are opaque: no material, animation or flag says otherwise".to_owned()];
    }
    Kind::ALL
        .into_iter()
        .filter_map(|kind| {
            let of: Vec<&KindCount> = counts.iter().filter(|c| c.kind == kind).collect();
            let sum: u64 = of.iter().map(|c| c.triangles).sum();
            let reasons: Vec<String> = of.iter().map(|c| format!("{} {}", c.triangles, c.reason)).collect();
            (sum > 0).then(|| format!("{}: {sum} triangles ({})", kind.name(), reasons.join(", ")))
        })
        .collect()
}

/// Refuses a scene that is not the one a result was baked from.
pub fn check_scene(scene: &Scene, pvs: &Pvs, path: &Path, result: &Path) -> Result<(), CliError> {
    if scene.len() != pvs.triangle_count() {
        return Err(CliError::Input(format!(
            "{} has {}, but {} was baked from another scene, one of {}; name that scene",
            path.display(),
            plural(scene.len() as usize, "triangle"),
            result.display(),
            pvs.triangle_count()
        )));
    }
    let info: serde_json::Value = serde_json::from_str(pvs.info_json()).unwrap_or_default();
    // A result written by another program may lack the digest.
    if info["scene"].as_str().is_some_and(|digest| digest != scene.digest().to_string()) {
        return Err(CliError::Input(format!(
            "{} was baked from another scene than {}, or with other flags about what blocks and shows; name \
             that scene, or bake again",
            result.display(),
            path.display()
        )));
    }
    Ok(())
}
