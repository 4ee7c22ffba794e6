//! The curves as SVG: one panel for each scene, logarithmic axes, one colour and mark for each sampler.
//!
//! The file has a style sheet with colours for light and dark pages. The crate plotters writes a fixed colour
//! into every element and has no style sheets, so this module writes the SVG itself.

use std::fmt::Write as _;

use crate::curves::{Point, SceneCurves};
use crate::ladder::Sampler;

/// A panel's plot area, and what is around it for labels.
const PLOT: [f64; 2] = [400.0, 280.0];
const LEFT: f64 = 72.0;
const ABOVE: f64 = 34.0;
const PANEL: [f64; 2] = [LEFT + PLOT[0] + 20.0, ABOVE + PLOT[1] + 54.0];
/// A legend entry.
const ENTRY: [f64; 2] = [118.0, 20.0];

/// Background, text and lines, then the samplers; first on light pages, then on dark ones.
const COLOURS: [(&str, &str, &str); 9] = [
    ("paper", "#ffffff", "#15171c"),
    ("ink", "#24272e", "#d9dce3"),
    ("grid", "#d8dbe2", "#363b46"),
    ("lines", "#0b63b5", "#6db6ff"),
    ("guided", "#c74e00", "#ff9f5a"),
    ("cubes-uniform", "#6b6f78", "#a9afbc"),
    ("cubes-err", "#1f7d3a", "#63cf86"),
    ("cubes-err1", "#8343ad", "#cb9df0"),
    ("cubes-err2", "#ad2566", "#f58bbd"),
];

/// All scenes in one picture.
pub fn draw(scenes: &[SceneCurves]) -> String {
    let columns = scenes.len().clamp(1, 2);
    let width = columns as f64 * PANEL[0];
    let (legend, top) = legend(scenes, width);
    let height = top + scenes.len().div_ceil(columns) as f64 * PANEL[1];
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
         height=\"{height}\" role=\"img\" font-family=\"system-ui, sans-serif\" font-size=\"12\">\n\
         <title>Time against error</title>\n<style>\n{}</style>\n\
         <rect class=\"paper\" width=\"100%\" height=\"100%\" fill=\"currentColor\"/>\n{legend}",
        style()
    );
    for (i, scene) in scenes.iter().enumerate() {
        let (x, y) = ((i % columns) as f64 * PANEL[0] + LEFT, top + (i / columns) as f64 * PANEL[1] + ABOVE);
        svg += &format!("<g transform=\"translate({x} {y})\">\n{}</g>\n", panel(scene));
    }
    svg += "</svg>\n";
    svg
}

fn style() -> String {
    let rules = |dark: bool| {
        COLOURS.map(|(class, l, d)| format!(".{class}{{color:{}}}\n", if dark { d } else { l })).concat()
    };
    format!("{}@media (prefers-color-scheme: dark){{\n{}}}\n", rules(false), rules(true))
}

/// The samplers' marks and names, then what the two kinds of lines are; and how high that is.
fn legend(scenes: &[SceneCurves], width: f64) -> (String, f64) {
    let samplers = scenes.first().map_or(&[][..], |s| &s.samplers);
    let mut entries: Vec<_> =
        samplers.iter().map(|&s| (s.name(), s.name(), false, mark(s, 12.0, 0.0, 1.0))).collect();
    entries.push(("ink", "mean error", false, String::new()));
    entries.push(("ink", "p99 error", true, String::new()));
    let per_row = ((width - 20.0) / ENTRY[0]).floor().max(1.0) as usize;
    let mut text = String::new();
    for (i, (class, name, thin, mark)) in entries.iter().enumerate() {
        let (x, y) = (12.0 + (i % per_row) as f64 * ENTRY[0], 20.0 + (i / per_row) as f64 * ENTRY[1]);
        text += &format!(
            "<g transform=\"translate({x} {y})\"><g class=\"{class}\">{}{mark}</g>{}</g>\n",
            polyline(&[(0.0, 0.0), (24.0, 0.0)], *thin),
            label(29.0, 4.0, "start", name)
        );
    }
    (text, 14.0 + entries.len().div_ceil(per_row) as f64 * ENTRY[1])
}

/// A logarithmic axis over whole decades.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Axis {
    /// Powers of ten.
    least: i32,
    most: i32,
    /// Where they are drawn.
    from: f64,
    to: f64,
}

impl Axis {
    /// Over what has a logarithm; a decade where that is nothing.
    fn over(values: impl Iterator<Item = f64> + Clone, from: f64, to: f64) -> Self {
        let logs = values.filter(|v| *v > 0.0 && v.is_finite()).map(f64::log10);
        let low = logs.clone().fold(f64::INFINITY, f64::min);
        let high = logs.fold(f64::NEG_INFINITY, f64::max);
        if low > high {
            return Self { least: 0, most: 1, from, to };
        }
        let least = low.floor() as i32;
        Self { least, most: (high.ceil() as i32).max(least + 1), from, to }
    }

    /// Where a value is; what has no logarithm is at the lower end.
    fn at(&self, value: f64) -> f64 {
        let (least, most) = (f64::from(self.least), f64::from(self.most));
        let log = if value > 0.0 { value.log10().clamp(least, most) } else { least };
        self.from + (log - least) / (most - least) * (self.to - self.from)
    }

    /// The decades, and what is 2 to 9 times them.
    fn ticks(&self) -> (Vec<i32>, Vec<f64>) {
        let decades = self.least..self.most;
        let minor = decades.flat_map(|d| (2..10).map(move |k| f64::from(k) * 10f64.powi(d)));
        ((self.least..=self.most).collect(), minor.collect())
    }
}

/// A power of ten as people write it.
fn decade(power: i32) -> String {
    match power {
        -5..=-1 => format!("{:.*}", power.unsigned_abs() as usize, 10f64.powi(power)),
        0..=5 => format!("{:.0}", 10f64.powi(power)),
        _ => format!("1e{power}"),
    }
}

/// A scene's axes and curves; the origin is the plot's upper left corner.
fn panel(scene: &SceneCurves) -> String {
    let [width, height] = PLOT;
    let percent = |fraction: f64| 100.0 * fraction;
    let errors = scene.points.iter().flat_map(|p| [percent(p.mean_error), percent(p.p99_error)]);
    let x = Axis::over(scene.points.iter().map(|p| p.seconds), 0.0, width);
    let y = Axis::over(errors, height, 0.0);
    let mut svg = axes(&x, &y);
    let name = format!("{}, {} triangles", scene.scene, scene.triangles);
    let _ = writeln!(
        svg,
        "<text class=\"ink\" x=\"0\" y=\"-12\" fill=\"currentColor\" font-size=\"14\" \
            font-weight=\"600\">{}</text>",
        escaped(&name)
    );
    for &sampler in &scene.samplers {
        let along = |error: fn(&Point) -> f64| -> Vec<_> {
            scene.of(sampler).map(|p| (x.at(p.seconds), y.at(percent(error(p))))).collect()
        };
        let (mean, p99) = (along(|p| p.mean_error), along(|p| p.p99_error));
        svg += &format!("<g class=\"{}\">{}{}", sampler.name(), polyline(&p99, true), polyline(&mean, false));
        for (&(px, py), point) in mean.iter().zip(scene.of(sampler)) {
            // Hollow: no wrong pixel at all, which has no place on this axis but the edge.
            svg += &mark(sampler, px, py, if point.mean_error > 0.0 { 1.0 } else { 0.0 });
        }
        svg += "</g>\n";
    }
    svg
}

fn axes(x: &Axis, y: &Axis) -> String {
    let [width, height] = PLOT;
    let line = |class: &str, x0: f64, y0: f64, x1: f64, y1: f64| {
        format!(
            "<line class=\"{class}\" x1=\"{x0:.1}\" y1=\"{y0:.1}\" x2=\"{x1:.1}\" y2=\"{y1:.1}\" \
                stroke=\"currentColor\"/>\n"
        )
    };
    let mut svg = String::new();
    let (decades, minor) = x.ticks();
    for d in decades {
        let at = x.at(10f64.powi(d));
        svg += &line("grid", at, 0.0, at, height);
        svg += &label(at, height + 18.0, "middle", &decade(d));
    }
    for at in minor.into_iter().map(|v| x.at(v)) {
        svg += &line("ink", at, height - 4.0, at, height);
    }
    let (decades, minor) = y.ticks();
    for d in decades {
        let at = y.at(10f64.powi(d));
        svg += &line("grid", 0.0, at, width, at);
        svg += &label(-8.0, at + 4.0, "end", &format!("{} %", decade(d)));
    }
    for at in minor.into_iter().map(|v| y.at(v)) {
        svg += &line("ink", 0.0, at, 4.0, at);
    }
    svg += &line("ink", 0.0, 0.0, 0.0, height);
    svg += &line("ink", 0.0, height, width, height);
    svg += &label(width / 2.0, height + 38.0, "middle", "seconds of the whole command");
    svg + "\n"
}

fn label(x: f64, y: f64, anchor: &str, text: &str) -> String {
    format!(
        "<text class=\"ink\" x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" \
            fill=\"currentColor\">{}</text>",
        escaped(text)
    )
}

fn polyline(points: &[(f64, f64)], thin: bool) -> String {
    let points: Vec<_> = points.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
    let looks = if thin { "stroke-width=\"1\" stroke-dasharray=\"4 3\"" } else { "stroke-width=\"2\"" };
    format!("<polyline points=\"{}\" fill=\"none\" stroke=\"currentColor\" {looks}/>", points.join(" "))
}

/// A sampler's mark: its shape tells what its colour does, to those who see no colours. `filled` is its
/// opacity.
fn mark(sampler: Sampler, x: f64, y: f64, filled: f64) -> String {
    let shape = match sampler {
        Sampler::Lines => {
            return format!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.6\" {}/>", looks(filled));
        }
        Sampler::Guided => "M-3.4,-3.4h6.8v6.8h-6.8z",
        Sampler::CubesUniform => "M-4,0h8M0,-4v8",
        Sampler::CubesErr => "M0,-4.4l4,7.2h-8z",
        Sampler::CubesErr1 => "M0,4.4l4,-7.2h-8z",
        Sampler::CubesErr2 => "M0,-4.8l4.8,4.8l-4.8,4.8l-4.8,-4.8z",
    };
    format!("<path transform=\"translate({x:.1} {y:.1})\" d=\"{shape}\" {}/>", looks(filled))
}

fn looks(filled: f64) -> String {
    format!("fill=\"currentColor\" fill-opacity=\"{filled}\" stroke=\"currentColor\"")
}

/// Text as XML takes it: no markup, and no control characters, which it cannot say at all.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&apos;"),
            c if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
pub mod tests {
    use clap::ValueEnum as _;

    use super::*;
    use crate::ladder::Ladder;

    /// A scene with all samplers; the finest point of each has no error.
    pub fn example(name: &str) -> SceneCurves {
        let mut points = Vec::new();
        for &sampler in Sampler::value_variants() {
            let rungs = sampler.rungs(Ladder::Quick);
            for (i, rung) in rungs.iter().enumerate() {
                let error = if i + 1 < rungs.len() { 0.1f64.powi(i as i32 + 1) } else { 0.0 };
                points.push(Point {
                    sampler,
                    parameter: rung.parameter.clone(),
                    seconds: 0.4 * f64::powi(3.0, i as i32),
                    mean_error: error,
                    p99_error: 5.0 * error,
                    max_error: 9.0 * error,
                    peak_mb: None,
                    bytes_per_cell: 1.5,
                    samples: 10.0,
                    mean_visible: 7.25,
                });
            }
        }
        let samplers = Sampler::value_variants().to_vec();
        SceneCurves { scene: name.to_owned(), triangles: 12, samplers, points }
    }

    /// Reads tags and attributes as strictly as XML does, as far as this file uses it; the text between tags
    /// comes back.
    fn read(xml: &str) -> String {
        let (mut open, mut text, mut rest) = (Vec::new(), String::new(), xml);
        let mut roots = 0;
        while let Some(start) = rest.find('<') {
            let between = &rest[..start];
            assert!(!between.contains('>'), "{between}");
            assert!(between.trim().is_empty() || !open.is_empty(), "text outside: {between}");
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
        assert!(open.is_empty() && rest.trim().is_empty() && roots == 1, "{open:?} {rest}");
        for (i, _) in text.match_indices('&') {
            let entity = ["amp", "lt", "gt", "quot", "apos"];
            assert!(entity.iter().any(|e| text[i + 1..].starts_with(&format!("{e};"))), "{}", &text[i..]);
        }
        text
    }

    #[test]
    fn the_picture_is_well_formed() {
        let mut nothing = example("nothing");
        nothing.points.clear();
        for scenes in [vec![], vec![example("a")], vec![example("a"), example("b"), nothing]] {
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
        assert!(text.contains("&lt;/text&gt;&lt;a b=&quot;c&quot;&gt;&amp;\u{fffd}&apos;, 12"), "{text}");
    }

    #[test]
    fn axes_are_whole_decades() {
        let axis = Axis::over([0.3, 40.0, 0.0].into_iter(), 0.0, 300.0);
        assert_eq!((axis.least, axis.most), (-1, 2));
        assert!((axis.at(1.0) - 100.0).abs() < 1e-9);
        assert_eq!(axis.at(0.0), 0.0);
        assert_eq!(axis.ticks().0.into_iter().map(decade).collect::<Vec<_>>(), ["0.1", "1", "10", "100"]);
        let flat = Axis::over([10.0].into_iter(), 0.0, 1.0);
        assert_eq!((flat.least, flat.most), (1, 2));
    }
}
