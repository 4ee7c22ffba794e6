//! The formatting of numbers, durations and scenes for notes, errors and the command.

use std::time::Duration;

use sightline_scene::Scene;
use sightline_scene::kinds::{KindCount, SurfaceKind};

/// Formats a number with its noun, in the plural unless the number is 1.
pub fn plural(n: usize, noun: &str) -> String {
    format!("{n} {noun}{}", if n == 1 { "" } else { "s" })
}

/// Formats a duration in a unit that suits its length.
pub fn human(d: Duration) -> String {
    let s = d.as_secs_f64();
    match s {
        s if s < 10.0 => format!("{s:.1} s"),
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

/// Formats the kinds and sides of a scene, one line each.
pub fn scene_in_words(scene: &Scene) -> Vec<String> {
    let mut lines = kinds_in_words(&scene.kinds().counts());
    let one_sided = scene.sides().one_sided();
    if one_sided > 0 {
        lines.push(sides_in_words(Some(one_sided)));
    }
    lines
}

/// Formats a line about culled back faces, with the number of one-sided triangles if it is known.
pub fn sides_in_words(one_sided: Option<u64>) -> String {
    let count = one_sided.map_or(String::new(), |n| format!(" ({n} triangles)"));
    format!("back faces are culled: triangles without a double-sided material have one side{count}")
}

/// Formats the kinds of a scene, one line each.
pub fn kinds_in_words(counts: &[KindCount]) -> Vec<String> {
    if counts.is_empty() {
        return vec![
            "all triangles are opaque: no material, animation or flag sets another kind".to_owned(),
        ];
    }
    SurfaceKind::ALL
        .into_iter()
        .filter_map(|kind| {
            let counted: Vec<&KindCount> = counts.iter().filter(|c| c.kind == kind).collect();
            let sum: u64 = counted.iter().map(|c| c.triangles).sum();
            let reasons: Vec<String> = counted
                .iter()
                .map(|c| format!("{} {}", c.triangles, c.reason))
                .collect();
            (sum > 0).then(|| format!("{}: {sum} triangles ({})", kind.name(), reasons.join(", ")))
        })
        .collect()
}
