//! The parts of a job's message, for tests that change one of them.

use sightline_proto::v1;

/// Returns the visibility task of a job.
///
/// # Panics
/// Panics if the job has another task.
pub fn task(spec: &mut v1::JobSpec) -> &mut v1::Visibility {
    match &mut spec.task {
        Some(v1::job_spec::Task::Visibility(task)) => task,
        other => panic!("{other:?} is not visibility"),
    }
}

/// Returns the sampling of a job.
///
/// # Panics
/// Panics if the job does not sample.
pub fn sampling(spec: &mut v1::JobSpec) -> &mut v1::Sampling {
    let sampling = match &mut task(spec).method {
        Some(v1::visibility::Method::Aggressive(method)) => &mut method.sampling,
        Some(v1::visibility::Method::Exact(method)) => &mut method.sampling,
        other => panic!("{other:?} samples nothing"),
    };
    sampling.as_mut().unwrap()
}

/// Returns the cubes of a job.
///
/// # Panics
/// Panics if the job has another sampler.
pub fn cubes(spec: &mut v1::JobSpec) -> &mut v1::Cubes {
    match &mut sampling(spec).sampler {
        Some(v1::sampling::Sampler::Cubes(cubes)) => cubes,
        other => panic!("{other:?} is not cubes"),
    }
}

/// Returns the cubes' grid of cells.
///
/// # Panics
/// Panics if the job has other cells.
pub fn cube_grid(spec: &mut v1::JobSpec) -> &mut v1::CubeGrid {
    match &mut cubes(spec).cells {
        Some(v1::cubes::Cells::Grid(grid)) => grid,
        other => panic!("{other:?} is not a grid"),
    }
}
