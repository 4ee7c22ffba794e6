//! The curves as SVG: panels for each scene, logarithmic axes, and one colour and mark per sampler.
//!
//! The file has a style sheet with colours for light and dark pages. The crate plotters writes a fixed colour
//! into every element and does not support style sheets, so this module writes the SVG itself.

use crate::curves::SceneCurves;
use crate::ladder::Shows;
use crate::panel::{PLOT, panels};
use crate::shapes::{label, mark, polyline};

/// The margins of a panel's plot area, for labels.
const LEFT: f64 = 72.0;
const ABOVE: f64 = 34.0;
const PANEL: [f64; 2] = [LEFT + PLOT[0] + 20.0, ABOVE + PLOT[1] + 54.0];
/// The width and height of a legend entry.
const ENTRY: [f64; 2] = [118.0, 20.0];

/// The colours of background, text and lines, then of the samplers: first on light pages, then on dark ones.
const COLOURS: [(&str, &str, &str); 13] = [
    ("paper", "#ffffff", "#15171c"),
    ("ink", "#24272e", "#d9dce3"),
    ("grid", "#d8dbe2", "#363b46"),
    ("lines", "#0b63b5", "#6db6ff"),
    ("guided", "#c74e00", "#ff9f5a"),
    ("guided-own", "#8a6d3b", "#d3b57e"),
    ("cubes-uniform", "#6b6f78", "#a9afbc"),
    ("cubes-err", "#1f7d3a", "#63cf86"),
    ("cubes-err1", "#8343ad", "#cb9df0"),
    ("cubes-err2", "#ad2566", "#f58bbd"),
    ("max-error", "#00768a", "#4fd0e4"),
    ("verified", "#7a5c00", "#e0bd4f"),
    ("exact", "#a02020", "#ff8f8f"),
];

/// Draws all scenes in one picture.
pub fn draw(scenes: &[SceneCurves]) -> String {
    let panels: Vec<String> = scenes.iter().flat_map(panels).collect();
    let columns = panels.len().clamp(1, 2);
    let width = columns as f64 * PANEL[0];
    let (legend, top) = legend(scenes, width);
    let height = top + panels.len().div_ceil(columns) as f64 * PANEL[1];
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
         height=\"{height}\" role=\"img\" font-family=\"system-ui, sans-serif\" font-size=\"12\">\n\
         <title>Curves of sightline bench</title>\n<style>\n{}</style>\n\
         <rect class=\"paper\" width=\"100%\" height=\"100%\" fill=\"currentColor\"/>\n{legend}",
        style()
    );
    for (i, panel) in panels.iter().enumerate() {
        let (x, y) = (
            (i % columns) as f64 * PANEL[0] + LEFT,
            top + (i / columns) as f64 * PANEL[1] + ABOVE,
        );
        svg += &format!("<g transform=\"translate({x} {y})\">\n{panel}</g>\n");
    }
    svg += "</svg>\n";
    svg
}

fn style() -> String {
    let rules = |dark: bool| {
        COLOURS
            .map(|(class, l, d)| format!(".{class}{{color:{}}}\n", if dark { d } else { l }))
            .concat()
    };
    format!(
        "{}@media (prefers-color-scheme: dark){{\n{}}}\n",
        rules(false),
        rules(true)
    )
}

/// Returns the legend and its height. The legend shows the marks and names of the samplers, then the meaning
/// of the two kinds of lines.
fn legend(scenes: &[SceneCurves], width: f64) -> (String, f64) {
    let samplers = scenes.first().map_or(&[][..], |s| &s.samplers);
    let mut entries: Vec<_> = samplers
        .iter()
        .map(|&s| (s.name(), s.name(), false, mark(s, 12.0, 0.0, 1.0)))
        .collect();
    if samplers.iter().any(|s| s.shows() == Shows::Error) {
        entries.push(("ink", "mean error", false, String::new()));
        entries.push(("ink", "p99 error", true, String::new()));
    }
    let per_row = ((width - 20.0) / ENTRY[0]).floor().max(1.0) as usize;
    let mut text = String::new();
    for (i, (class, name, thin, mark)) in entries.iter().enumerate() {
        let (x, y) = (
            12.0 + (i % per_row) as f64 * ENTRY[0],
            20.0 + (i / per_row) as f64 * ENTRY[1],
        );
        text += &format!(
            "<g transform=\"translate({x} {y})\"><g class=\"{class}\">{}{mark}</g>{}</g>\n",
            polyline(&[(0.0, 0.0), (24.0, 0.0)], *thin),
            label(29.0, 4.0, "start", name)
        );
    }
    (
        text,
        14.0 + entries.len().div_ceil(per_row) as f64 * ENTRY[1],
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::curves::tests::example;
    use crate::ladder::Sampler;

    /// Parses the tags and attributes that this file uses as strictly as XML requires. Returns the text
    /// between tags.
    fn read(xml: &str) -> String {
        let (mut open, mut text, mut rest) = (Vec::new(), String::new(), xml);
        let mut roots = 0;
        while let Some(start) = rest.find('<') {
            let between = &rest[..start];
            assert!(!between.contains('>'), "{between}");
            assert!(
                between.trim().is_empty() || !open.is_empty(),
                "text outside: {between}"
            );
            text += between;
            let end = start + rest[start..].find('>').expect("a tag ends");
            let tag = &rest[start + 1..end];
            rest = &rest[end + 1..];
            if let Some(name) = tag.strip_prefix('/') {
                assert_eq!(open.pop(), Some(name));
                continue;
            }
            let (body, alone) = tag.strip_suffix('/').map_or((tag, false), |b| (b, true));
            let (name, mut attributes) = body.split_once(' ').unwrap_or((body, ""));
            let mut names = Vec::new();
            while let Some((attribute, after)) = attributes.trim_start().split_once("=\"") {
                let (value, after) = after.split_once('"').expect("a value ends");
                assert!(!names.contains(&attribute), "{attribute} twice in {tag}");
                assert!(!value.contains(['<', '&']), "{value}");
                assert!(!value.contains("NaN") && !value.contains("inf"), "{tag}");
                names.push(attribute);
                attributes = after;
            }
            assert!(attributes.trim().is_empty(), "{tag}");
            roots += usize::from(open.is_empty());
            if !alone {
                open.push(name);
            }
        }
        assert!(
            open.is_empty() && rest.trim().is_empty() && roots == 1,
            "{open:?} {rest}"
        );
        for (i, _) in text.match_indices('&') {
            let entity = ["amp", "lt", "gt", "quot", "apos"];
            assert!(
                entity
                    .iter()
                    .any(|e| text[i + 1..].starts_with(&format!("{e};"))),
                "{}",
                &text[i..]
            );
        }
        text
    }

    #[test]
    fn picture_is_well_formed() {
        let mut nothing = example("nothing");
        nothing.points.clear();
        for scenes in [
            vec![],
            vec![example("a")],
            vec![example("a"), example("b"), nothing],
        ] {
            let svg = draw(&scenes);
            read(&svg);
            assert!(!svg.contains("script"));
            for scene in scenes {
                assert!(svg.contains(&format!(">{}, 12 triangles<", scene.scene)));
            }
        }
    }

    #[test]
    fn names_cannot_become_markup() {
        let svg = draw(&[example("</text><a b=\"c\">&\u{1}'")]);
        let text = read(&svg);
        assert!(
            text.contains("&lt;/text&gt;&lt;a b=&quot;c&quot;&gt;&amp;\u{fffd}&apos;, 12"),
            "{text}"
        );
    }

    #[test]
    fn each_kind_of_curve_has_a_panel_and_a_colour() {
        let svg = draw(&[example("a")]);
        let text = read(&svg);
        for title in [
            "a, 12 triangles",
            "a: undecided after a time budget",
            "a: time of an exact cell",
        ] {
            assert!(text.contains(title), "{title}");
        }
        let mut one = example("a");
        one.samplers = vec![Sampler::Exact];
        one.points.retain(|p| p.sampler == Sampler::Exact);
        let text = read(&draw(&[one]));
        assert!(
            !text.contains("undecided after") && !text.contains("mean error"),
            "{text}"
        );
        for sampler in example("a").samplers {
            assert!(
                COLOURS.iter().any(|(class, ..)| *class == sampler.name()),
                "{}",
                sampler.name()
            );
        }
    }
}
