//! The options of a benchmark.

use std::path::PathBuf;

use clap::ValueEnum;
use glam::DVec3;
use sightline_scene::Aabb;

use crate::error::BenchError;
use crate::frontier::ERRORS;
use crate::ladder::{Ladder, Sampler};

/// The measurements of a benchmark, and their output files.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// The scenes: .obj, .ply, .gltf or .glb. Only `--grow triangles` generates its own scenes.
    pub scenes: Vec<PathBuf>,
    /// The number of view cells of the regular grid along x, y and z. Default: 8 each.
    pub cells: [u32; 3],
    /// The box of the viewpoints: x0,y0,z0,x1,y1,z1. Default: each scene's bounds.
    pub view_box: Option<Aabb>,
    /// The number of random viewpoints of the error measure, equal for every point. The 99th percentile of
    /// the errors needs at least 100. Default: 200.
    pub viewpoints: u32,
    /// The seed of the viewpoints. Default: 7.
    pub seed: u64,
    /// The side of a face of the error measure in pixels, 8 to 4096. Default: 256.
    pub resolution: u32,
    /// The folder for curves.csv, curves.svg and growth.csv, which is created if it does not exist. Default:
    /// `bench`.
    pub out: PathBuf,
    /// The samplers to measure. Default: [`Sampler::DEFAULT`]; with `--grow`: none, only the growth.
    pub samplers: Option<Vec<Sampler>>,
    /// The range of each sampler's parameter. Default: [`Ladder::Quick`].
    pub points: Ladder,
    /// The number of bakes per point. The time of the point is the median. Default: 1.
    pub repeat: u32,
    /// The time limit of a bake in seconds. After a slower bake, the benchmark skips the finer points of its
    /// sampler, or the larger points of its growth. Default: 60.
    pub max_seconds: f64,
    /// The error limit: after a bake with at most this mean error, a fraction of the pixels, the benchmark
    /// skips the finer points of its sampler. Default: the lowest error of the table.
    pub least_error: f64,
    /// The quantities whose effect on time and memory is measured: bakes with `--sampler lines` and
    /// `--grow-error`.
    pub grow: Vec<Growth>,
    /// The `--target-error` of the bakes of `--grow`. Default: 0.001.
    pub grow_error: f64,
    /// The path of a Markdown file for all results, with the machine and the command line.
    pub results: Option<PathBuf>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            scenes: Vec::new(),
            cells: [8; 3],
            view_box: None,
            viewpoints: 200,
            seed: 7,
            resolution: 256,
            out: "bench".into(),
            samplers: None,
            points: Ladder::Quick,
            repeat: 1,
            max_seconds: 60.0,
            least_error: ERRORS[ERRORS.len() - 1],
            grow: Vec::new(),
            grow_error: 0.001,
            results: None,
        }
    }
}

/// The quantity that grows while all others stay constant.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Growth {
    /// Generated forests of 10 000 to 1 000 000 triangles (10 000 000 with --points full).
    Triangles,
    /// 2x2x2 to 16x16x16 cells (32x32x32 with --points full) on each scene.
    Cells,
    /// 1, 2 and 4 workers on each scene.
    Workers,
}

impl Options {
    /// Returns the samplers to measure, each once.
    pub fn samplers(&self) -> Vec<Sampler> {
        let asked = match &self.samplers {
            Some(asked) => asked.as_slice(),
            None if self.grow.is_empty() => &Sampler::DEFAULT,
            None => &[],
        };
        let mut once = Vec::new();
        for &sampler in asked {
            if !once.contains(&sampler) {
                once.push(sampler);
            }
        }
        once
    }

    /// Rejects options that would fail only after bakes, or measure nothing.
    ///
    /// # Errors
    /// [`BenchError::Usage`] with the option at fault.
    pub fn check(&self) -> Result<(), BenchError> {
        let refuse = |what: &str| Err(BenchError::Usage(what.to_owned()));
        let needs_scene =
            !self.samplers().is_empty() || self.grow.iter().any(|g| *g != Growth::Triangles);
        if needs_scene && self.scenes.is_empty() {
            return refuse("name a scene to measure; only --grow triangles needs none");
        }
        if !(8..=4096).contains(&self.resolution) {
            return refuse(&format!(
                "--resolution {} is not between 8 and 4096",
                self.resolution
            ));
        }
        if self.viewpoints == 0 {
            return refuse("--viewpoints 0 measures nothing; give at least 1");
        }
        if self.repeat == 0 {
            return refuse("--repeat 0 measures nothing; give at least 1");
        }
        if self.max_seconds.is_nan() || self.max_seconds <= 0.0 {
            return refuse(&format!(
                "--max-seconds {} is not above 0",
                self.max_seconds
            ));
        }
        if !(0.0..=1.0).contains(&self.least_error) {
            return refuse(&format!(
                "--least-error {} is not between 0 and 1",
                self.least_error
            ));
        }
        if !(1e-6..=1.0).contains(&self.grow_error) {
            return refuse(&format!(
                "--grow-error {} is not between 0.000001 and 1",
                self.grow_error
            ));
        }
        Ok(())
    }

    /// Returns a grid as flags of `bake`.
    pub fn grid([x, y, z]: [u32; 3]) -> [String; 2] {
        ["--cells".to_owned(), format!("{x}x{y}x{z}")]
    }

    /// Returns a grid and the view box as flags of `bake`.
    pub fn division(&self, cells: [u32; 3]) -> Vec<String> {
        let mut flags = Self::grid(cells).to_vec();
        flags.extend(self.view_box.map(view_box));
        flags
    }

    /// Returns a block in the middle of the grid, as flags of `bake`: the grid and the box. The block has at
    /// most `most` cells per axis. `bounds` are the bounds of the scene.
    pub fn block(&self, most: u32, bounds: Aabb) -> Vec<String> {
        let whole = self.view_box.unwrap_or(bounds);
        let (low, size) = (whole.min.as_dvec3(), (whole.max - whole.min).as_dvec3());
        let cells = self.cells.map(|n| n.clamp(1, most.max(1)));
        let at = |cells: [u32; 3]| {
            let part = DVec3::from_array(
                [0, 1, 2].map(|k| f64::from(cells[k]) / f64::from(self.cells[k].max(1))),
            );
            (low + part * size).as_vec3()
        };
        let first = [0, 1, 2].map(|k| (self.cells[k].max(1) - cells[k]) / 2);
        let last = [0, 1, 2].map(|k| first[k] + cells[k]);
        let mut flags = Self::grid(cells).to_vec();
        flags.push(view_box(Aabb {
            min: at(first),
            max: at(last),
        }));
        flags
    }
}

/// Returns a box as a flag of `bake`.
fn view_box(Aabb { min, max }: Aabb) -> String {
    // Rust prints the shortest number that parses to the same value.
    let numbers = min
        .to_array()
        .into_iter()
        .chain(max.to_array())
        .map(|n| n.to_string());
    format!("--view-box={}", numbers.collect::<Vec<_>>().join(","))
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    #[test]
    fn block_is_in_middle_and_not_larger_than_grid() {
        let options = Options {
            cells: [8, 3, 1],
            ..Options::default()
        };
        let bounds = Aabb {
            min: Vec3::new(-8.0, 0.0, 1.0),
            max: Vec3::new(8.0, 6.0, 2.0),
        };
        assert_eq!(
            options.block(2, bounds),
            ["--cells", "2x2x1", "--view-box=-2,0,1,2,4,2"]
        );
        assert_eq!(
            options.block(99, bounds),
            ["--cells", "8x3x1", "--view-box=-8,0,1,8,6,2"]
        );
        // The view box replaces the bounds.
        let options = Options {
            view_box: Some(Aabb {
                min: Vec3::ZERO,
                max: Vec3::ONE,
            }),
            ..options
        };
        assert_eq!(
            options.block(1, bounds)[2],
            "--view-box=0.375,0.33333334,0,0.5,0.6666667,1"
        );
    }

    #[test]
    fn check_rejects_zero_repeats() {
        let options = Options {
            scenes: vec!["a.glb".into()],
            ..Options::default()
        };
        assert!(options.check().is_ok());
        assert!(matches!(
            Options {
                repeat: 0,
                ..options
            }
            .check(),
            Err(BenchError::Usage(_))
        ));
    }
}
