//! Plots as SVG.
//!
//! The texts of the plots have the colour of the surrounding page, light or dark. The crate plotters writes a
//! fixed colour into every element, so this module writes the SVG itself.

use std::fmt::Write as _;

const WIDE: f64 = 520.0;
const HIGH: f64 = 260.0;
const LEFT: f64 = 64.0;
const BOTTOM: f64 = 40.0;

/// Plots, for each value on a logarithmic axis, the fraction of values that are at most as large. Values
/// below `least`, including zeros, are at the left border.
pub fn cumulative(values: &[f64], least: f64, name: &str) -> String {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|x| !x.is_nan()).collect();
    sorted.sort_by(f64::total_cmp);
    let Some(greatest) = sorted.last().copied() else {
        return String::new();
    };
    let (low, high) = (least.log10(), greatest.max(least * 10.0).log10().ceil());
    let x = |v: f64| LEFT + (v.max(least).log10() - low) / (high - low) * (WIDE - LEFT - 10.0);
    let y = |share: f64| 10.0 + (1.0 - share) * (HIGH - BOTTOM - 10.0);
    let mut path = format!("M{:.1} {:.1}", x(least), y(0.0));
    for (k, v) in sorted.iter().enumerate() {
        // Writing to a string cannot fail.
        let (before, now) = (
            k as f64 / sorted.len() as f64,
            (k + 1) as f64 / sorted.len() as f64,
        );
        let _ = write!(
            path,
            "L{:.1} {:.1}L{:.1} {:.1}",
            x(*v),
            y(before),
            x(*v),
            y(now)
        );
    }
    let _ = write!(path, "L{:.1} {:.1}", WIDE - 10.0, y(1.0));
    let mut marks = String::new();
    for decade in low.ceil() as i32..=high as i32 {
        let at = x(10f64.powi(decade));
        let _ = write!(
            marks,
            "<path d=\"M{at:.1} 10V{:.1}\" stroke=\"#8884\"/><text x=\"{at:.1}\" y=\"{:.1}\" \
             text-anchor=\"middle\">{}</text>",
            HIGH - BOTTOM,
            HIGH - BOTTOM + 14.0,
            percent(10f64.powi(decade))
        );
    }
    framed(
        name,
        "fraction of values",
        &format!("{marks}<path d=\"{path}\" fill=\"none\" stroke=\"#2f7ed8\" stroke-width=\"2\"/>"),
    )
}

/// Plots points on linear axes from 0.
pub fn scatter(points: &[[f64; 2]], names: [&str; 2]) -> String {
    scatter_with(points, None, names)
}

/// Plots points on linear axes from 0. The point `chosen` is red.
pub fn scatter_with(points: &[[f64; 2]], chosen: Option<[f64; 2]>, names: [&str; 2]) -> String {
    let all = || points.iter().chain(&chosen);
    let most = |k: usize| all().map(|p| p[k]).fold(0.0, f64::max);
    let most = [most(0), most(1)].map(|m| if m > 0.0 { m } else { 1.0 });
    let x = |v: f64| LEFT + v / most[0] * (WIDE - LEFT - 10.0);
    let y = |v: f64| 10.0 + (1.0 - v / most[1]) * (HIGH - BOTTOM - 10.0);
    let mut dots = String::new();
    for [a, b] in points {
        // Writing to a string cannot fail.
        let _ = write!(
            dots,
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"2.5\"/>",
            x(*a),
            y(*b)
        );
    }
    let chosen = chosen.map_or_else(String::new, |[a, b]| {
        format!(
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"4\" fill=\"#d33\"/>",
            x(a),
            y(b)
        )
    });
    let ends = format!(
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text><text x=\"{:.1}\" y=\"20\" \
         text-anchor=\"end\">{}</text>",
        WIDE - 10.0,
        HIGH - BOTTOM + 14.0,
        short(most[0]),
        LEFT - 4.0,
        short(most[1])
    );
    framed(
        names[0],
        names[1],
        &format!("{ends}<g fill=\"#2f7ed8\" fill-opacity=\"0.5\">{dots}</g>{chosen}"),
    )
}

/// Returns a plot with its axes.
fn framed(x: &str, y: &str, inside: &str) -> String {
    format!(
        "<svg viewBox=\"0 0 {WIDE} {HIGH}\" role=\"img\"><path d=\"M{LEFT} 10V{0}H{1}\" fill=\"none\" \
         stroke=\"currentColor\"/><text x=\"{2}\" y=\"{3}\" text-anchor=\"middle\">{x}</text><text \
         transform=\"translate(14 {4}) rotate(-90)\" text-anchor=\"middle\">{y}</text>{inside}</svg>",
        HIGH - BOTTOM,
        WIDE - 10.0,
        (WIDE + LEFT) / 2.0,
        HIGH - 8.0,
        HIGH / 2.0
    )
}

/// Formats a fraction in percent, with few digits.
pub fn percent(fraction: f64) -> String {
    let p = fraction * 100.0;
    match p {
        0.0 => "0 %".to_owned(),
        p if p >= 10.0 => format!("{p:.0} %"),
        p if p >= 1.0 => format!("{p:.1} %"),
        p if p >= 0.001 => {
            let text = format!("{p:.4}");
            format!("{} %", text.trim_end_matches('0').trim_end_matches('.'))
        }
        p => format!("{p:.0e} %"),
    }
}

/// Formats a number with few digits.
fn short(x: f64) -> String {
    if x >= 1000.0 {
        format!("{x:.0}")
    } else {
        format!("{x:.3}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fractions_are_short() {
        let all = [0.0, 1e-7, 1e-5, 0.00012, 0.01, 0.25, 1.0].map(percent);
        assert_eq!(
            all,
            [
                "0 %", "1e-5 %", "0.001 %", "0.012 %", "1.0 %", "25 %", "100 %"
            ]
        );
    }

    #[test]
    fn plots_of_no_values_and_zeros_are_valid() {
        assert_eq!(cumulative(&[], 1e-6, "x"), "");
        assert!(cumulative(&[0.0, f64::NAN], 1e-6, "x").contains("</svg>"));
        assert!(!scatter(&[[0.0, 0.0]], ["a", "b"]).contains("NaN"));
    }
}
