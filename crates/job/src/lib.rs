//! What a job is: its specification, checked, with its key and its plan.
//!
//! The coordinator and the workers agree on a job through this crate and the wire format alone. It holds no state
//! and does no work.

use glam::Vec3;
use prost::Message as _;
use sightline_proto::v1;
use sightline_sampling::lines::MOST_DEPTH;
use sightline_sampling::params::{
    BackendChoice, ErrorMeasure, ParamsError, Sampler, SamplingParams, SupersetChoice,
};
pub use sightline_viewcells::MOST_BLOCK_CELLS;
use sightline_viewcells::{Division, DivisionError, Lattice, Layout, Plan};

/// Changes whenever the same specification would give other bytes, of a result or of a tile, so that stored results are never mistaken for
/// those of another version.
pub const ALGORITHM_VERSION: u32 = 16;

/// Longest time budget, ten years.
const MAX_BUDGET_MS: u64 = 10 * 366 * 24 * 3600 * 1000;

/// A checked specification.
#[derive(Clone, Debug, PartialEq)]
pub struct JobSpec {
    /// Digest of the scene.
    pub scene: [u8; 32],
    /// How the view box is divided.
    pub division: Division,
    /// Least and greatest corner of the view box.
    pub view_box: [Vec3; 2],
    /// Sampling parameters.
    pub sampling: SamplingParams,
    /// Which backend.
    pub backend: BackendChoice,
    /// Seed of everything random.
    pub seed: u64,
    /// Sampling stops this many milliseconds after submission; 0 for no limit.
    pub time_budget_ms: u64,
    /// Most grid cells of a tile of the samplers that share lines within one, 1 to [`MOST_BLOCK_CELLS`].
    pub block_cells: u32,
    /// How far visibility is decided.
    pub method: Method,
    /// Whether witnesses and certificates are kept.
    pub certificates: bool,
}

/// How far visibility is decided.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// By sampling alone.
    #[default]
    Aggressive,
    /// By exact queries as well, about everything.
    Exact,
    /// The same with lower limits for a single query.
    Verified,
}

impl std::fmt::Display for Method {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Aggressive => "aggressive",
            Self::Exact => "exact",
            Self::Verified => "verified",
        })
    }
}

/// Most blocks of a job, about: the scheduler looks through all of them.
const MOST_BLOCKS: u64 = 1 << 16;

/// Work, in triangles divided by the target error, above which a tile has fewer cells. It is a guess at what makes a tile
/// take so long that a lost worker, a pause and a second machine count for more than the lines shared.
const HEAVY: [(f64, u32); 2] = [(5e10, 64), (5e9, 128)];

/// Cells of a tile that are decided exactly: seconds each on real scenes, beside which what sampling saves in large blocks is nothing.
const EXACT_BLOCK: u32 = 8;

/// Most cells of a tile, where nobody asks for another number.
pub fn default_block_cells(triangles: u32, sampling: &SamplingParams, method: Method) -> u32 {
    if method != Method::Aggressive {
        return EXACT_BLOCK;
    }
    let work = match sampling.sampler {
        Sampler::Lines => {
            // A bound is aimed at from well below it.
            let aim = sampling.max_error.map_or(1.0, |most| most * sightline_sampling::lines::bound::AIM);
            f64::from(triangles) / aim.min(sampling.target_error)
        }
        Sampler::Guided | Sampler::Cubes => 0.0,
    };
    HEAVY.iter().find(|(least, _)| work >= *least).map_or(MOST_BLOCK_CELLS, |(_, cells)| *cells)
}

/// Why a specification is refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SpecError {
    /// A field is missing or has the wrong length.
    #[error("the job's {0} is missing or malformed; {1}")]
    Field(&'static str, &'static str),
    /// The division of the view box.
    #[error(transparent)]
    Division(#[from] DivisionError),
    /// A sampling parameter.
    #[error(transparent)]
    Params(#[from] ParamsError),
}

impl JobSpec {
    /// Reads and checks a specification. `bounds` is taken for the view box when the message has none.
    ///
    /// # Errors
    /// [`SpecError`] naming the field.
    pub fn from_proto(m: &v1::JobSpec, bounds: Option<[Vec3; 2]>) -> Result<Self, SpecError> {
        let scene = m.scene.as_slice().try_into();
        let scene = scene.map_err(|_| SpecError::Field("scene", "give the 32 bytes of its digest"))?;
        let division = match m.division {
            Some(v1::job_spec::Division::Grid(g)) => Division::Grid([g.x, g.y, g.z]),
            Some(v1::job_spec::Division::Adaptive(a)) => {
                Division::Adaptive { budget: a.triangle_budget, max_depth: a.max_depth }
            }
            None => return Err(SpecError::Field("division", "give a grid or an adaptive division")),
        };
        let view_box = match (m.view_box.as_slice(), bounds) {
            ([x0, y0, z0, x1, y1, z1], _) => [Vec3::new(*x0, *y0, *z0), Vec3::new(*x1, *y1, *z1)],
            ([], Some(bounds)) => bounds,
            _ => return Err(SpecError::Field("view box", "give x0,y0,z0,x1,y1,z1")),
        };
        let s = m.sampling.ok_or(SpecError::Field("sampling", "give the sampling parameters"))?;
        let sampling = SamplingParams {
            sampler: match s.sampler() {
                v1::Sampler::Lines => Sampler::Lines,
                v1::Sampler::Cubes => Sampler::Cubes,
                v1::Sampler::Guided => Sampler::Guided,
            },
            target_error: s.target_error,
            max_error: s.max_error,
            rays: s.rays,
            resolution: s.resolution,
            measure: match s.measure() {
                v1::ErrorMeasure::Strata => ErrorMeasure::Strata,
                v1::ErrorMeasure::Sets => ErrorMeasure::Sets,
                v1::ErrorMeasure::Pixels => ErrorMeasure::Pixels,
            },
            error_threshold: s.error_threshold,
            interior_threshold: s.interior_threshold,
            min_distance: s.min_distance,
            solids: s.solids,
            superset: match s.superset() {
                v1::Superset::Auto => SupersetChoice::Auto,
                v1::Superset::On => SupersetChoice::On,
                v1::Superset::Off => SupersetChoice::Off,
            },
        };
        let backend = match m.backend() {
            v1::Backend::Auto => BackendChoice::Auto,
            v1::Backend::Gpu => BackendChoice::Gpu,
            v1::Backend::Cpu => BackendChoice::Cpu,
        };
        let spec = Self {
            scene,
            division,
            view_box,
            sampling,
            backend,
            seed: m.seed,
            time_budget_ms: m.time_budget_ms,
            // Cubes and adaptive trees have no blocks to choose; what they make no use of makes no other job.
            block_cells: match m.block_cells {
                given @ 1.. if s.sampler() != v1::Sampler::Cubes && matches!(division, Division::Grid(_)) => {
                    given
                }
                _ => MOST_BLOCK_CELLS,
            },
            method: match v1::Method::try_from(m.method) {
                Ok(v1::Method::Aggressive) => Method::Aggressive,
                Ok(v1::Method::Exact) => Method::Exact,
                Ok(v1::Method::Verified) => Method::Verified,
                Err(_) => {
                    return Err(SpecError::Field(
                        "method",
                        "it is none this program knows; give aggressive, exact or verified",
                    ));
                }
            },
            certificates: m.certificates,
        };
        spec.sampling.check()?;
        if spec.block_cells > MOST_BLOCK_CELLS {
            return Err(SpecError::Field("block-cells", "give 1 to 512 cells"));
        }
        let cubes = spec.sampling.sampler == Sampler::Cubes;
        let adaptive = matches!(division, Division::Adaptive { .. });
        if adaptive && spec.sampling.sampler == Sampler::Guided {
            return Err(SpecError::Field("sampler", "an adaptive division is sampled with lines or cubes"));
        }
        if matches!(division, Division::Adaptive { max_depth, .. } if max_depth > MOST_DEPTH)
            && spec.sampling.sampler == Sampler::Lines
        {
            return Err(SpecError::Field("max-depth", "trees deeper than 12 are sampled with cubes"));
        }
        if adaptive && spec.sampling.max_error.is_some() {
            return Err(SpecError::Field("max-error", "only the cells of a grid are refined to a bound"));
        }
        if spec.sampling.max_error.is_some() && spec.sampling.sampler != Sampler::Lines {
            return Err(SpecError::Field("max-error", "only the sampler lines refines to a bound"));
        }
        if spec.certificates && spec.method == Method::Aggressive {
            return Err(SpecError::Field(
                "certificates",
                "sampling alone has none; give the method exact or verified",
            ));
        }
        if spec.time_budget_ms > MAX_BUDGET_MS {
            return Err(SpecError::Field("time-budget", "give at most ten years"));
        }
        if spec.time_budget_ms > 0 && cubes {
            return Err(SpecError::Field("time-budget", "the sampler cubes cannot stop early"));
        }
        spec.lattice()?;
        // The lattice has seen to it that the product can be formed.
        if let Division::Grid(cells) = division
            && cells.map(u64::from).iter().product::<u64>() / u64::from(spec.block_cells) > MOST_BLOCKS
        {
            return Err(SpecError::Field(
                "block-cells",
                "so few make too many tiles; give more cells a tile",
            ));
        }
        Ok(spec)
    }

    /// The specification as a message, with everything spelled out.
    pub fn to_proto(&self) -> v1::JobSpec {
        let [min, max] = self.view_box.map(|c| c.to_array());
        let s = &self.sampling;
        v1::JobSpec {
            scene: self.scene.to_vec(),
            division: Some(match self.division {
                Division::Grid([x, y, z]) => v1::job_spec::Division::Grid(v1::Grid { x, y, z }),
                Division::Adaptive { budget, max_depth } => {
                    v1::job_spec::Division::Adaptive(v1::Adaptive { triangle_budget: budget, max_depth })
                }
            }),
            view_box: min.into_iter().chain(max).collect(),
            sampling: Some(v1::Sampling {
                sampler: match s.sampler {
                    Sampler::Lines => v1::Sampler::Lines,
                    Sampler::Cubes => v1::Sampler::Cubes,
                    Sampler::Guided => v1::Sampler::Guided,
                }
                .into(),
                target_error: s.target_error,
                max_error: s.max_error,
                rays: s.rays,
                resolution: s.resolution,
                measure: match s.measure {
                    ErrorMeasure::Strata => v1::ErrorMeasure::Strata,
                    ErrorMeasure::Sets => v1::ErrorMeasure::Sets,
                    ErrorMeasure::Pixels => v1::ErrorMeasure::Pixels,
                }
                .into(),
                error_threshold: s.error_threshold,
                interior_threshold: s.interior_threshold,
                min_distance: s.min_distance,
                solids: s.solids,
                superset: match s.superset {
                    SupersetChoice::Auto => v1::Superset::Auto,
                    SupersetChoice::On => v1::Superset::On,
                    SupersetChoice::Off => v1::Superset::Off,
                }
                .into(),
            }),
            backend: match self.backend {
                BackendChoice::Auto => v1::Backend::Auto,
                BackendChoice::Gpu => v1::Backend::Gpu,
                BackendChoice::Cpu => v1::Backend::Cpu,
            }
            .into(),
            seed: self.seed,
            time_budget_ms: self.time_budget_ms,
            block_cells: self.block_cells,
            method: match self.method {
                Method::Aggressive => v1::Method::Aggressive,
                Method::Exact => v1::Method::Exact,
                Method::Verified => v1::Method::Verified,
            }
            .into(),
            certificates: self.certificates,
        }
    }

    /// The job's key: digest of everything its result depends on, but for the numerics profile, which is bound when
    /// the job first runs and is then part of the result.
    pub fn key(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new_derive_key("sightline 2026 job key");
        hasher.update(&ALGORITHM_VERSION.to_le_bytes());
        // Prost writes fields in the order of their numbers, so equal specifications give equal bytes.
        hasher.update(&self.to_proto().encode_to_vec());
        *hasher.finalize().as_bytes()
    }

    /// The lattice of sample positions.
    ///
    /// # Errors
    /// [`DivisionError`]; never after [`JobSpec::from_proto`], which has checked it.
    pub fn lattice(&self) -> Result<Lattice, DivisionError> {
        self.division.lattice(self.view_box[0], self.view_box[1])
    }

    /// The part of a view cell, where they are thinnest, that sight lines have to cross to count, and refuses cells that are thinner than
    /// that; 0 where nothing depends on it. Exact methods find whatever sampling misses.
    ///
    /// To be asked of new jobs; those of an earlier version keep their results.
    ///
    /// # Errors
    /// [`DivisionError`].
    pub fn moved_by_rounding(&self) -> Result<f64, DivisionError> {
        let lattice = self.lattice()?;
        match (self.sampling.sampler, self.method) {
            (Sampler::Lines, Method::Aggressive) => self.division.moved_by_rounding(&lattice),
            _ => Ok(0.0),
        }
    }

    /// Lattice and plan.
    ///
    /// # Errors
    /// As [`JobSpec::lattice`].
    pub fn plan(&self) -> Result<(Lattice, Plan), DivisionError> {
        let lattice = self.lattice()?;
        let layout = match self.sampling.sampler {
            Sampler::Cubes => Layout::Samples,
            Sampler::Lines | Sampler::Guided => Layout::Blocks(self.block_cells),
        };
        Ok((lattice, Plan::new(&self.division, &lattice, layout)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spec() -> JobSpec {
        JobSpec {
            scene: [7; 32],
            division: Division::Grid([4, 3, 2]),
            view_box: [Vec3::ZERO, Vec3::ONE],
            sampling: SamplingParams::default(),
            backend: BackendChoice::Auto,
            seed: 3,
            time_budget_ms: 0,
            block_cells: 64,
            method: Method::Aggressive,
            certificates: false,
        }
    }

    #[test]
    fn what_is_written_is_read_and_every_field_is_in_the_key() {
        let s = spec();
        assert_eq!(JobSpec::from_proto(&s.to_proto(), None).unwrap(), s);
        let sampling = s.sampling.clone();
        let others = [
            JobSpec { scene: [8; 32], ..s.clone() },
            JobSpec {
                division: Division::Adaptive { budget: 5, max_depth: 6 },
                sampling: SamplingParams { sampler: Sampler::Cubes, ..sampling.clone() },
                block_cells: MOST_BLOCK_CELLS,
                ..s.clone()
            },
            JobSpec { time_budget_ms: 5, ..s.clone() },
            JobSpec { block_cells: 65, ..s.clone() },
            JobSpec { method: Method::Exact, ..s.clone() },
            JobSpec { method: Method::Exact, certificates: true, ..s.clone() },
            JobSpec { method: Method::Verified, ..s.clone() },
            JobSpec {
                sampling: SamplingParams { sampler: Sampler::Guided, ..sampling.clone() },
                ..s.clone()
            },
            JobSpec { sampling: SamplingParams { target_error: 0.01, ..sampling.clone() }, ..s.clone() },
            JobSpec { sampling: SamplingParams { max_error: Some(0.01), ..sampling.clone() }, ..s.clone() },
            JobSpec { sampling: SamplingParams { rays: 5, ..sampling.clone() }, ..s.clone() },
            JobSpec { view_box: [Vec3::ZERO, Vec3::new(1.0, 1.0, 2.0)], ..s.clone() },
            JobSpec { backend: BackendChoice::Gpu, ..s.clone() },
            JobSpec { seed: 4, ..s.clone() },
            JobSpec { sampling: SamplingParams { resolution: 64, ..sampling.clone() }, ..s.clone() },
            JobSpec {
                sampling: SamplingParams { measure: ErrorMeasure::Sets, ..sampling.clone() },
                ..s.clone()
            },
            JobSpec { sampling: SamplingParams { error_threshold: 0.9, ..sampling.clone() }, ..s.clone() },
            JobSpec { sampling: SamplingParams { interior_threshold: 0.9, ..sampling.clone() }, ..s.clone() },
            JobSpec { sampling: SamplingParams { min_distance: 0.25, ..sampling.clone() }, ..s.clone() },
            JobSpec { sampling: SamplingParams { solids: false, ..sampling.clone() }, ..s.clone() },
            JobSpec { sampling: SamplingParams { superset: SupersetChoice::On, ..sampling }, ..s.clone() },
        ];
        let mut keys: Vec<_> = others.iter().map(JobSpec::key).chain([s.key()]).collect();
        keys.sort_unstable();
        keys.dedup();
        assert_eq!(keys.len(), others.len() + 1);
        for o in &others {
            assert_eq!(&JobSpec::from_proto(&o.to_proto(), None).unwrap(), o);
        }
    }

    #[test]
    fn cells_thinner_than_rounding_are_refused_where_lines_decide() {
        // Two metres at five million: five steps of 32-bit coordinates.
        let far = |wide: f32| [Vec3::new(5e6, 0.0, 0.0), Vec3::new(5e6 + wide, wide, wide)];
        let lines = |wide, division| JobSpec {
            view_box: far(wide),
            division,
            method: Method::Aggressive,
            certificates: false,
            sampling: SamplingParams::default(),
            ..spec()
        };
        let thin = lines(16.0, Division::Grid([8; 3]));
        assert!(thin.moved_by_rounding().unwrap_err().to_string().contains("2.00e0 wide along x"));
        let by_cubes = SamplingParams { sampler: Sampler::Cubes, ..SamplingParams::default() };
        assert_eq!(JobSpec { sampling: by_cubes, ..thin.clone() }.moved_by_rounding(), Ok(0.0));
        assert_eq!(JobSpec { method: Method::Exact, ..thin }.moved_by_rounding(), Ok(0.0));
        let part = lines(160.0, Division::Grid([8; 3])).moved_by_rounding().unwrap();
        assert!((0.2..0.3).contains(&part), "{part}");
        // Halved along each axis, as such a tree is in any case.
        let tree = |wide| lines(wide, Division::Adaptive { budget: 5, max_depth: 6 }).moved_by_rounding();
        assert!(tree(8.0).is_err() && tree(16.0).is_ok());
    }

    #[test]
    fn nonsense_is_refused_by_field() {
        let good = spec().to_proto();
        let refuse = |m: v1::JobSpec| JobSpec::from_proto(&m, None).unwrap_err().to_string();
        assert!(refuse(v1::JobSpec { scene: vec![1], ..good.clone() }).contains("scene"));
        assert!(refuse(v1::JobSpec { division: None, ..good.clone() }).contains("division"));
        assert!(refuse(v1::JobSpec { view_box: vec![], ..good.clone() }).contains("view box"));
        assert!(refuse(v1::JobSpec { block_cells: 513, ..good.clone() }).contains("block-cells"));
        assert!(refuse(v1::JobSpec { sampling: None, ..good.clone() }).contains("sampling"));
        assert!(refuse(v1::JobSpec { method: 9, ..good.clone() }).contains("method"));
        assert!(refuse(v1::JobSpec { certificates: true, ..good.clone() }).contains("certificates"));
        let adaptive = JobSpec {
            division: Division::Adaptive { budget: 5, max_depth: 12 },
            block_cells: MOST_BLOCK_CELLS,
            ..spec()
        };
        let deep = JobSpec { division: Division::Adaptive { budget: 5, max_depth: 13 }, ..adaptive.clone() };
        assert!(refuse(deep.to_proto()).contains("max-depth"));
        assert_eq!(JobSpec::from_proto(&adaptive.to_proto(), None).unwrap(), adaptive);
        let with = |sampler, max_error| {
            let sampling = SamplingParams { sampler, max_error, ..SamplingParams::default() };
            refuse(JobSpec { sampling, ..adaptive.clone() }.to_proto())
        };
        assert!(with(Sampler::Guided, None).contains("sampler"));
        assert!(with(Sampler::Lines, Some(0.01)).contains("max-error"));
        let nan = v1::Sampling { error_threshold: f64::NAN, ..good.sampling.unwrap() };
        assert!(refuse(v1::JobSpec { sampling: Some(nan), ..good }).contains("error-threshold"));
    }
}
