//! Time against error: bakes a scene with every sampler from coarse to fine and measures each result.

use std::ffi::OsString;

use serde::Serialize;

use crate::children::{Children, number};
use crate::error::BenchError;
use crate::frontier::{self, Needed, Ratio};
use crate::host::Host;
use crate::input::{Input, bake_line};
use crate::ladder::{Rung, Sampler};
use crate::options::Options;
use crate::percent::percent;

/// One bake and what it came to.
#[derive(Clone, Debug, Serialize)]
pub struct Point {
    /// How it was sampled.
    pub sampler: Sampler,
    /// With which parameter.
    pub parameter: String,
    /// The whole command, start to exit.
    pub seconds: f64,
    /// Wrong pixels, as fractions.
    pub mean_error: f64,
    /// Of the frame that 99 % of the frames are no worse than.
    pub p99_error: f64,
    /// Of the worst frame.
    pub max_error: f64,
    /// `None` where the system does not tell.
    pub peak_mb: Option<f64>,
    /// Of the sets.
    pub bytes_per_cell: f64,
    /// Rays or cubes, whatever the sampler counts.
    pub samples: f64,
    /// Triangles in a cell's set.
    pub mean_visible: f64,
}

/// A scene's points.
#[derive(Clone, Debug, Serialize)]
pub struct SceneCurves {
    /// As tables and files call it.
    pub scene: String,
    /// How many it has.
    pub triangles: u32,
    /// The samplers asked for.
    pub samplers: Vec<Sampler>,
    /// All points, by sampler, coarse to fine.
    pub points: Vec<Point>,
}

impl SceneCurves {
    /// A sampler's points.
    pub fn of(&self, sampler: Sampler) -> impl Iterator<Item = &Point> {
        self.points.iter().filter(move |p| p.sampler == sampler)
    }

    /// Seconds a sampler needs for a mean error.
    pub fn needed(&self, sampler: Sampler, error: f64) -> Needed {
        let points: Vec<_> = self.of(sampler).map(|p| (p.seconds, p.mean_error)).collect();
        frontier::needed(&points, error)
    }

    /// How many times longer the baseline takes than lines.
    pub fn ratio(&self, error: f64) -> Option<Ratio> {
        frontier::ratio(self.needed(Sampler::Guided, error), self.needed(Sampler::Lines, error))
    }
}

/// Measures a scene with all samplers.
pub fn measure(
    args: &Options,
    host: &Host<'_>,
    children: &Children,
    input: &Input,
) -> Result<SceneCurves, BenchError> {
    let samplers = args.samplers();
    let mut points = Vec::new();
    for &sampler in &samplers {
        let rungs = sampler.rungs(args.points);
        let count = rungs.len();
        let mut rungs = rungs.into_iter().enumerate().peekable();
        while let Some((i, rung)) = rungs.next() {
            (host.say)(&format!(
                "{}, {} {}: point {} of {count} …",
                input.name,
                sampler.name(),
                rung.parameter,
                i + 1
            ));
            let point = point(args, children, input, sampler, rung)?;
            (host.say)(&format!(
                "{}, {} {}: {} s, mean error {}, p99 {}",
                input.name,
                sampler.name(),
                point.parameter,
                frontier::seconds(point.seconds),
                percent(point.mean_error),
                percent(point.p99_error)
            ));
            let enough = if point.seconds > args.max_seconds {
                Some(format!("took more than {} s (--max-seconds)", args.max_seconds))
            } else if point.mean_error <= args.least_error {
                Some(format!("has no more than {} wrong (--least-error)", percent(args.least_error)))
            } else {
                None
            };
            points.push(point);
            if let (Some(why), Some(_)) = (enough, rungs.peek()) {
                let (scene, sampler) = (&input.name, sampler.name());
                (host.say)(&format!("{scene}, {sampler}: finer points are left out, as this one {why}"));
                break;
            }
        }
    }
    Ok(SceneCurves { scene: input.name.clone(), triangles: input.triangles, samplers, points })
}

fn point(
    args: &Options,
    children: &Children,
    input: &Input,
    sampler: Sampler,
    rung: Rung,
) -> Result<Point, BenchError> {
    let folder = tempfile::tempdir().map_err(BenchError::internal)?;
    let result = folder.path().join("out.pvs");
    let mut line = bake_line(&input.path, folder.path());
    line.extend(args.division(args.cells).into_iter().chain(rung.flags).map(OsString::from));
    let (bake, took) = children.run(line)?;
    let mut line: Vec<OsString> = vec!["measure".into(), input.path.clone().into(), result.into()];
    let flags = [
        ("--viewpoints", args.viewpoints.to_string()),
        ("--seed", args.seed.to_string()),
        ("--resolution", args.resolution.to_string()),
    ];
    line.extend(flags.into_iter().flat_map(|(flag, value)| [flag.into(), value.into()]));
    let (measured, _) = children.run(line)?;
    Ok(Point {
        sampler,
        parameter: rung.parameter,
        seconds: took.as_secs_f64(),
        mean_error: number(&measured, "mean_error")?,
        p99_error: number(&measured, "p99_error")?,
        max_error: number(&measured, "max_error")?,
        peak_mb: bake["peak_memory_bytes"].as_f64().map(|b| b / 1e6),
        bytes_per_cell: number(&bake, "bytes_per_cell")?,
        samples: number(&bake, "samples")?,
        mean_visible: number(&bake, "mean_visible")?,
    })
}
