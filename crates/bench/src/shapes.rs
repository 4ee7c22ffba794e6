//! The elements of the curves as SVG: text, lines and the marks of the samplers.

use crate::ladder::Sampler;

/// Returns a line of text.
pub fn label(x: f64, y: f64, anchor: &str, text: &str) -> String {
    format!(
        "<text class=\"ink\" x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" \
            fill=\"currentColor\">{}</text>",
        escaped(text)
    )
}

/// Returns a curve, which is thin and dashed if `thin` is true.
pub fn polyline(points: &[(f64, f64)], thin: bool) -> String {
    let points: Vec<_> = points
        .iter()
        .map(|(x, y)| format!("{x:.1},{y:.1}"))
        .collect();
    let looks = if thin {
        "stroke-width=\"1\" stroke-dasharray=\"4 3\""
    } else {
        "stroke-width=\"2\""
    };
    format!(
        "<polyline points=\"{}\" fill=\"none\" stroke=\"currentColor\" {looks}/>",
        points.join(" ")
    )
}

/// Returns the mark of a sampler. Its shape identifies the sampler without its colour. `filled` is the
/// opacity of the mark.
pub fn mark(sampler: Sampler, x: f64, y: f64, filled: f64) -> String {
    let shape = match sampler {
        Sampler::Lines => {
            return format!(
                "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.6\" {}/>",
                looks(filled)
            );
        }
        Sampler::Guided => "M-3.4,-3.4h6.8v6.8h-6.8z",
        Sampler::GuidedOwn => "M-4.2,-4.2L4.2,4.2M-4.2,4.2L4.2,-4.2",
        Sampler::CubesUniform => "M-4,0h8M0,-4v8",
        Sampler::CubesErr => "M0,-4.4l4,7.2h-8z",
        Sampler::CubesErr1 => "M0,4.4l4,-7.2h-8z",
        Sampler::CubesErr2 => "M0,-4.8l4.8,4.8l-4.8,4.8l-4.8,-4.8z",
        Sampler::MaxError => "M-4.4,-1.5h8.8v3h-8.8z",
        Sampler::Verified => "M-1.5,-4.4h3v8.8h-3z",
        Sampler::Exact => "M0,-4.4l4.2,3l-1.6,5h-5.2l-1.6,-5z",
    };
    format!(
        "<path transform=\"translate({x:.1} {y:.1})\" d=\"{shape}\" {}/>",
        looks(filled)
    )
}

fn looks(filled: f64) -> String {
    format!("fill=\"currentColor\" fill-opacity=\"{filled}\" stroke=\"currentColor\"")
}

/// Escapes text for XML. Replaces control characters, which XML cannot represent, by U+FFFD.
pub fn escaped(text: &str) -> String {
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
