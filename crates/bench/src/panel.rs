//! A panel of the curves: time against error, time against undecided triangles, or cells against the time per
//! cell.

use std::fmt::Write as _;

use crate::axis::{Axis, decade};
use crate::curves::{Point, SceneCurves};
use crate::ladder::{Sampler, Shows};
use crate::shapes::{escaped, label, mark, polyline};

/// The width and height of a panel's plot area.
pub const PLOT: [f64; 2] = [400.0, 280.0];

/// Returns the panels of a scene: one per kind of curve of the scene.
pub fn panels(scene: &SceneCurves) -> Vec<String> {
    let kinds = [Shows::Error, Shows::Undecided, Shows::CellTime].into_iter();
    kinds
        .filter(|&kind| !scene.showing(kind).is_empty())
        .map(|kind| panel(scene, kind))
        .collect()
}

/// The appearance of a kind of curve. It consists of the values along x, the values along y, and the values
/// of an optional thin curve.
struct Kind {
    title: String,
    along: &'static str,
    unit: &'static str,
    x: fn(&Point) -> f64,
    y: fn(&Point) -> f64,
    thin: Option<fn(&Point) -> f64>,
}

fn kind(scene: &SceneCurves, shows: Shows) -> Kind {
    let name = &scene.scene;
    let seconds = |p: &Point| p.times.seconds;
    match shows {
        Shows::Error => Kind {
            title: format!("{name}, {} triangles", scene.triangles),
            along: "seconds of the whole command",
            unit: " %",
            x: seconds,
            y: |p| 100.0 * p.mean_error,
            thin: Some(|p| 100.0 * p.p99_error),
        },
        Shows::Undecided => Kind {
            title: format!("{name}: undecided after a time budget"),
            along: "seconds of the whole command",
            unit: " %",
            x: seconds,
            y: |p| 100.0 * p.undecided_share,
            thin: None,
        },
        Shows::CellTime => Kind {
            title: format!("{name}: time of an exact cell"),
            along: "cells decided together",
            unit: " s",
            x: |p| p.cells,
            y: Point::cell_seconds,
            thin: None,
        },
    }
}

/// Returns a scene's axes and curves of one kind. The origin is the plot's upper left corner.
fn panel(scene: &SceneCurves, shows: Shows) -> String {
    let [width, height] = PLOT;
    let kind = kind(scene, shows);
    let points: Vec<&Point> = scene
        .points
        .iter()
        .filter(|p| p.sampler.shows() == shows)
        .collect();
    let thin = kind
        .thin
        .into_iter()
        .flat_map(|thin| points.iter().map(move |p| thin(p)));
    let up: Vec<f64> = points.iter().map(|p| (kind.y)(p)).chain(thin).collect();
    let x = Axis::over(points.iter().map(|p| (kind.x)(p)), 0.0, width);
    let y = Axis::over(up.into_iter(), height, 0.0);
    let mut svg = axes(&x, &y, kind.along, kind.unit);
    let _ = writeln!(
        svg,
        "<text class=\"ink\" x=\"0\" y=\"-12\" fill=\"currentColor\" font-size=\"14\" \
            font-weight=\"600\">{}</text>",
        escaped(&kind.title)
    );
    for sampler in scene.showing(shows) {
        svg += &curve(scene, sampler, &kind, &x, &y);
    }
    svg
}

/// Returns the curve through a sampler's points.
fn curve(scene: &SceneCurves, sampler: Sampler, kind: &Kind, x: &Axis, y: &Axis) -> String {
    let along = |value: fn(&Point) -> f64| -> Vec<_> {
        scene
            .points_of(sampler)
            .map(|p| (x.at((kind.x)(p)), y.at(value(p))))
            .collect()
    };
    let thin = kind
        .thin
        .map_or(String::new(), |value| polyline(&along(value), true));
    let points = along(kind.y);
    let mut svg = format!(
        "<g class=\"{}\">{thin}{}",
        sampler.name(),
        polyline(&points, false)
    );
    for (&(px, py), point) in points.iter().zip(scene.points_of(sampler)) {
        // A hollow mark means no error or no undecided pairs. Such a value is at the edge of the axis.
        svg += &mark(
            sampler,
            px,
            py,
            if (kind.y)(point) > 0.0 { 1.0 } else { 0.0 },
        );
    }
    svg + "</g>\n"
}

fn axes(x: &Axis, y: &Axis, along: &str, unit: &str) -> String {
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
        svg += &label(-8.0, at + 4.0, "end", &format!("{}{unit}", decade(d)));
    }
    for at in minor.into_iter().map(|v| y.at(v)) {
        svg += &line("ink", 0.0, at, 4.0, at);
    }
    svg += &line("ink", 0.0, 0.0, 0.0, height);
    svg += &line("ink", 0.0, height, width, height);
    svg += &label(width / 2.0, height + 38.0, "middle", along);
    svg + "\n"
}
