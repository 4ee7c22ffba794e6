//! The curves of a scene. The benchmark bakes the scene with every sampler from coarse to fine, and measures
//! each result.

use std::ffi::OsString;

use serde::Serialize;
use serde_json::Value;

use crate::children::{Children, number};
use crate::error::BenchError;
use crate::frontier::{self, Needed, Ratio};
use crate::host::Host;
use crate::input::Input;
use crate::ladder::{Rung, Sampler, Shows};
use crate::options::Options;
use crate::percent::percent;
use crate::repeats::{self, Runs};
use crate::timing::{Spread, Times};

/// The measurements of one bake, or of its repetitions.
#[derive(Clone, Debug, Serialize)]
pub struct Point {
    /// The sampler of the bake.
    pub sampler: Sampler,
    /// The parameter of the sampler, as text.
    pub parameter: String,
    /// The times of the whole command, from start to exit.
    #[serde(flatten)]
    pub times: Times,
    /// The mean error over all frames: the fraction of wrong pixels.
    pub mean_error: f64,
    /// The 99th percentile of the errors of the frames.
    pub p99_error: f64,
    /// The error of the worst frame.
    pub max_error: f64,
    /// The peak memory in megabytes; `None` if the system does not report it.
    pub peak_mb: Option<f64>,
    /// The size of the sets in bytes, per cell.
    pub bytes_per_cell: f64,
    /// The number of rays or cubes, depending on the sampler.
    pub samples: f64,
    /// The mean number of triangles in a cell's set.
    pub mean_visible: f64,
    /// The number of cells of the result.
    pub cells: f64,
    /// The number of undecided pairs of a cell and a triangle, as a fraction of all pairs, in the median run.
    pub undecided_share: f64,
    /// The largest bound of a cell on its missed sight lines; `None` without `--max-error`.
    pub greatest_bound: Option<f64>,
}

impl Point {
    /// Returns the seconds of the whole command per cell, including preparation.
    pub fn cell_seconds(&self) -> f64 {
        self.times.seconds / self.cells.max(1.0)
    }

    /// Returns the CPU seconds per cell, including preparation.
    pub fn cell_cpu_seconds(&self) -> Option<f64> {
        self.times.cpu_seconds.map(|s| s / self.cells.max(1.0))
    }
}

/// The measured points of a scene.
#[derive(Clone, Debug, Serialize)]
pub struct SceneCurves {
    /// The name of the scene in tables and files.
    pub scene: String,
    /// The number of triangles of the scene.
    pub triangles: u32,
    /// The samplers that the options select.
    pub samplers: Vec<Sampler>,
    /// All points, by sampler, from coarse to fine.
    pub points: Vec<Point>,
}

impl SceneCurves {
    /// Returns the points of a sampler.
    pub fn points_of(&self, sampler: Sampler) -> impl Iterator<Item = &Point> {
        self.points.iter().filter(move |p| p.sampler == sampler)
    }

    /// Returns the samplers whose curves show `shows`, in the order of the options.
    pub fn showing(&self, shows: Shows) -> Vec<Sampler> {
        self.samplers
            .iter()
            .copied()
            .filter(|s| s.shows() == shows)
            .collect()
    }

    /// Returns the seconds that a sampler needs for a mean error.
    pub fn needed(&self, sampler: Sampler, error: f64) -> Needed {
        let points: Vec<_> = self
            .points_of(sampler)
            .map(|p| (p.times.seconds, p.mean_error))
            .collect();
        frontier::needed(&points, error)
    }

    /// Returns the time of the baseline as a multiple of the time of the sampler lines, for a mean error.
    pub fn ratio(&self, error: f64) -> Option<Ratio> {
        frontier::ratio(
            self.needed(Sampler::Guided, error),
            self.needed(Sampler::Lines, error),
        )
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
            let name = format!("{}, {} {}", input.name, sampler.name(), rung.parameter);
            (host.say)(&format!("{name}: point {} of {count} …", i + 1));
            let point = point(args, host, children, input, sampler, rung, &name)?;
            (host.say)(&format!("{name}: {}", in_words(&point)));
            let enough = enough(args, &point);
            points.push(point);
            if let (Some(why), Some(_)) = (enough, rungs.peek()) {
                let (scene, sampler) = (&input.name, sampler.name());
                (host.say)(&format!(
                    "{scene}, {sampler}: finer points are skipped, because this point {why}"
                ));
                break;
            }
        }
    }
    Ok(SceneCurves {
        scene: input.name.clone(),
        triangles: input.triangles,
        samplers,
        points,
    })
}

/// Returns the text of a point in a line of progress.
fn in_words(point: &Point) -> String {
    let seconds = frontier::seconds(point.times.seconds);
    match point.sampler.shows() {
        Shows::Error => {
            let (mean, p99) = (percent(point.mean_error), percent(point.p99_error));
            format!("{seconds} s, mean error {mean}, p99 {p99}")
        }
        Shows::Undecided => format!("{seconds} s, {} undecided", percent(point.undecided_share)),
        Shows::CellTime => {
            format!(
                "{seconds} s, {} s per cell",
                frontier::seconds(point.cell_seconds())
            )
        }
    }
}

/// Returns the reason why the finer points of a sampler are not worth their time, or `None` to continue.
fn enough(args: &Options, point: &Point) -> Option<String> {
    let shows = point.sampler.shows();
    if point.times.seconds > args.max_seconds {
        Some(format!(
            "took more than {} s (--max-seconds)",
            args.max_seconds
        ))
    } else if shows == Shows::Error && point.mean_error <= args.least_error {
        Some(format!(
            "has at most {} wrong pixels (--least-error)",
            percent(args.least_error)
        ))
    } else if shows == Shows::Undecided && point.undecided_share <= 0.0 {
        Some("leaves no triangle undecided".to_owned())
    } else {
        None
    }
}

fn point(
    args: &Options,
    host: &Host<'_>,
    children: &Children,
    input: &Input,
    sampler: Sampler,
    rung: Rung,
    name: &str,
) -> Result<Point, BenchError> {
    let division = match rung.block {
        None => args.division(args.cells),
        Some(most) => args.block(most, input.bounds),
    };
    let flags: Vec<_> = division
        .into_iter()
        .chain(rung.flags)
        .map(OsString::from)
        .collect();
    let runs = repeats::bake(args, host, children, &input.path, &flags, name)?;
    let mut line: Vec<OsString> = vec![
        "measure".into(),
        input.path.clone().into(),
        runs.result().into(),
    ];
    let flags = [
        ("--viewpoints", args.viewpoints.to_string()),
        ("--seed", args.seed.to_string()),
        ("--resolution", args.resolution.to_string()),
    ];
    line.extend(
        flags
            .into_iter()
            .flat_map(|(flag, value)| [flag.into(), value.into()]),
    );
    let (measured, _) = children.run(line)?;
    let bake = runs.first();
    Ok(Point {
        sampler,
        parameter: rung.parameter,
        mean_error: number(&measured, "mean_error")?,
        p99_error: number(&measured, "p99_error")?,
        max_error: number(&measured, "max_error")?,
        peak_mb: bake["peak_memory_bytes"].as_f64().map(|b| b / 1e6),
        bytes_per_cell: number(bake, "bytes_per_cell")?,
        samples: number(bake, "samples")?,
        mean_visible: number(bake, "mean_visible")?,
        cells: number(bake, "cells")?,
        undecided_share: undecided(&runs)?,
        greatest_bound: bake["greatest_bound"].as_f64(),
        times: runs.times,
    })
}

/// Returns the median share of undecided pairs. With a time budget, each run may leave different pairs
/// undecided.
fn undecided(runs: &Runs) -> Result<f64, BenchError> {
    let share = |bake: &Value| {
        let pairs = number(bake, "cells")? * number(bake, "triangles")?;
        Ok(number(bake, "undecided")? / pairs.max(1.0))
    };
    let shares = runs
        .documents
        .iter()
        .map(share)
        .collect::<Result<Vec<_>, BenchError>>()?;
    Ok(Spread::from_values(&shares).map_or(0.0, |s| s.median))
}

#[cfg(test)]
pub mod tests {
    use clap::ValueEnum as _;

    use super::*;
    use crate::ladder::Ladder;
    use crate::timing::RunCost;

    /// Returns a scene with all samplers. The finest point of each sampler has no error and no undecided
    /// pairs.
    pub fn example(name: &str) -> SceneCurves {
        let mut points = Vec::new();
        for &sampler in Sampler::value_variants() {
            let rungs = sampler.rungs(Ladder::Quick);
            for (i, rung) in rungs.iter().enumerate() {
                let error = if i + 1 < rungs.len() {
                    0.1f64.powi(i as i32 + 1)
                } else {
                    0.0
                };
                let wall = 0.4 * f64::powi(3.0, i as i32);
                points.push(Point {
                    sampler,
                    parameter: rung.parameter.clone(),
                    times: Times::from_runs(&[1.0, 1.5, 1.25].map(|k| RunCost {
                        wall: k * wall,
                        cpu: Some(2.0 * wall),
                        load: None,
                    })),
                    mean_error: error,
                    p99_error: 5.0 * error,
                    max_error: 9.0 * error,
                    peak_mb: None,
                    bytes_per_cell: 1.5,
                    samples: 10.0,
                    mean_visible: 7.25,
                    cells: f64::from(rung.block.unwrap_or(8)).powi(3),
                    undecided_share: error,
                    greatest_bound: (sampler == Sampler::MaxError).then_some(0.002),
                });
            }
        }
        let samplers = Sampler::value_variants().to_vec();
        SceneCurves {
            scene: name.to_owned(),
            triangles: 12,
            samplers,
            points,
        }
    }

    #[test]
    fn sampler_ends_when_finer_points_add_no_information() {
        let args = Options {
            max_seconds: 10.0,
            ..Options::default()
        };
        let scene = example("a");
        let last = |sampler| scene.points_of(sampler).last().unwrap().clone();
        let why = |point: &Point| enough(&args, point).unwrap_or_default();
        let slow = Point {
            times: Times {
                seconds: 11.0,
                ..Times::default()
            },
            ..last(Sampler::Exact)
        };
        assert!(why(&slow).contains("--max-seconds"));
        let mut good = last(Sampler::Lines);
        good.times.seconds = 1.0;
        assert!(why(&good).contains("--least-error"));
        // An exact result always has no error, so this is not a reason to end.
        let quick = Point {
            times: good.times.clone(),
            ..last(Sampler::Exact)
        };
        assert_eq!(why(&quick), "");
        let mut open = Point {
            undecided_share: 0.1,
            times: good.times,
            ..last(Sampler::Verified)
        };
        assert_eq!(why(&open), "");
        open.undecided_share = 0.0;
        assert!(why(&open).contains("no triangle undecided"));
    }

    #[test]
    fn cell_time_is_share_of_command() {
        let scene = example("a");
        let block = scene.points_of(Sampler::Exact).last().unwrap();
        assert_eq!(block.cells, 8.0);
        assert_eq!(block.cell_seconds(), block.times.seconds / 8.0);
    }
}
