//! Queries about stored results.
//!
//! The coordinator reads sets. Because it does not sample, a [`SceneQueries`] program answers the queries
//! that need rays or exact visibility.

use std::sync::{Arc, PoisonError};

use sightline_proto::v1;
use sightline_pvs::{Pvs, PvsError};
use sightline_records::JobRecord;
use sightline_records::ids::JobId;
use sightline_scene::{Scene, SceneError, TriangleId};
use sightline_store::{BlobError, Blobs};
use sightline_viewcells::CellIndex;

use crate::coordinator::Coordinator;
use crate::jobs::control::{self, JobError};
use crate::jobs::stored_spec;
use crate::records::Records;
use crate::results::state::{ResultState, SceneQueries};
use crate::telemetry::metrics::CacheOutcome;

/// The number of faces of the cube that is rendered around a viewpoint.
const CUBE_FACES: u64 = 6;
/// Maximum number of pixels of a measurement. More pixels would make other queries wait for more than
/// seconds.
const MAX_PIXELS: u64 = 100_000_000;

/// The reason why a query has no answer.
#[derive(Debug, thiserror::Error)]
pub(crate) enum AskError {
    /// The job has no result.
    #[error(transparent)]
    Job(#[from] JobError),
    /// The query names an item that does not exist.
    #[error("{0}")]
    Wrong(String),
    /// The result, or this coordinator, cannot answer the query.
    #[error("{0}")]
    Unable(String),
    /// A blob cannot be read.
    #[error(transparent)]
    Blob(#[from] BlobError),
    /// The stored result is damaged.
    #[error(transparent)]
    Pvs(#[from] PvsError),
    /// The stored scene is damaged.
    #[error(transparent)]
    Scene(#[from] SceneError),
}

/// Opens a done job's result. The result that was queried last stays open.
fn open(c: &Coordinator, job: JobId) -> Result<Arc<Pvs>, AskError> {
    let digest = control::result(&c.records, job)?;
    has_sets(&c.records.existing_job(job).map_err(JobError::from)?)?;
    let mut last = c
        .results
        .last_queried
        .lock()
        .unwrap_or_else(PoisonError::into_inner);
    if let Some((_, pvs)) = last.as_ref().filter(|(queried, _)| *queried == digest) {
        c.telemetry
            .metrics
            .cache_request("result", CacheOutcome::Hit);
        return Ok(Arc::clone(pvs));
    }
    c.telemetry
        .metrics
        .cache_request("result", CacheOutcome::Miss);
    let pvs = Arc::new(Pvs::from_bytes(c.blobs.read(&digest)?)?);
    *last = Some((digest, Arc::clone(&pvs)));
    Ok(pvs)
}

/// Checks that a job computes visible sets, which can be queried.
pub(crate) fn has_sets(record: &JobRecord) -> Result<(), AskError> {
    let none = || {
        let id = record.id;
        AskError::Unable(format!(
            "job {id} computes ambient occlusion and has no sets; fetch its result with `Fetch`"
        ))
    };
    if stored_spec::receivers(&record.spec).is_some() {
        Err(none())
    } else {
        Ok(())
    }
}

/// Reads a job's record and its scene.
pub(crate) fn scene(
    records: &Records,
    blobs: &dyn Blobs,
    job: JobId,
) -> Result<(JobRecord, Scene), AskError> {
    let record = records.existing_job(job).map_err(JobError::from)?;
    let scene = Scene::from_blob(&record.name, &blobs.read(&record.scene)?)?;
    Ok((record, scene))
}

/// Returns the cell that contains a point.
fn cell_at(pvs: &Pvs, v1::Point { x, y, z }: v1::Point) -> Result<CellIndex, AskError> {
    pvs.find_cell([x, y, z]).map(CellIndex).ok_or_else(|| {
        let [min, max] = pvs.tree().view_box();
        AskError::Wrong(format!(
            "({x}, {y}, {z}) is outside the view box, which extends from {min:?} to {max:?}"
        ))
    })
}

/// Checks that a cell exists, and returns it.
fn cell_of(pvs: &Pvs, cell: CellIndex) -> Result<CellIndex, AskError> {
    let cells = pvs.cells();
    let none = || {
        AskError::Wrong(format!(
            "cell {cell} does not exist; the result has {cells} cells, numbered from 0"
        ))
    };
    (cell.0 < cells).then_some(cell).ok_or_else(none)
}

fn nowhere() -> AskError {
    AskError::Wrong("the query names no place; give a point or a cell".to_owned())
}

/// Answers a query for the set of a cell.
pub(crate) fn query(
    c: &Coordinator,
    asked: &v1::QueryRequest,
) -> Result<v1::QueryResponse, AskError> {
    use v1::query_request::From;
    let pvs = open(c, JobId(asked.job))?;
    let from = asked.from.ok_or_else(nowhere)?;
    let cell = match from {
        From::Point(point) => cell_at(&pvs, point)?,
        From::Cell(cell) => cell_of(&pvs, CellIndex(cell))?,
    };
    let (mut visible, mut undecided, mut names) = (Vec::new(), Vec::new(), Vec::new());
    if asked.objects {
        pvs.visible_objects(cell.0, &mut visible)?;
        pvs.undecided_objects(cell.0, &mut undecided)?;
        let name = |id: &u32| {
            pvs.objects()
                .get(*id as usize)
                .map_or_else(String::new, |o| o.name.clone())
        };
        names = visible.iter().map(name).collect();
    } else {
        pvs.visible(cell.0, &mut visible)?;
        pvs.undecided(cell.0, &mut undecided)?;
    }
    let bounds = pvs.cell_bounds(cell.0).unwrap_or_default();
    Ok(v1::QueryResponse {
        cell: cell.0,
        r#box: bounds.concat(),
        visible,
        undecided,
        names,
        set_aside: pvs.is_set_aside(cell.0)?,
    })
}

/// Explains why a triangle is visible or not. Stops if `is_gone` returns true.
pub(crate) fn why(
    c: &Coordinator,
    asked: &v1::WhyRequest,
    is_gone: &(dyn Fn() -> bool + Sync),
) -> Result<v1::WhyResponse, AskError> {
    use v1::why_request::From;
    let pvs = open(c, JobId(asked.job))?;
    let from = asked.from.ok_or_else(nowhere)?;
    let cell = match from {
        From::Point(point) => cell_at(&pvs, point)?,
        From::Cell(cell) => cell_of(&pvs, CellIndex(cell))?,
    };
    if asked.triangle >= pvs.triangle_count() {
        let (triangle, count) = (asked.triangle, pvs.triangle_count());
        return Err(AskError::Wrong(format!(
            "triangle {triangle} does not exist; the scene has {count} triangles, numbered from 0"
        )));
    }
    let (_, scene) = scene(&c.records, &*c.blobs, JobId(asked.job))?;
    c.results
        .queries_of_scenes()?
        .why(&pvs, scene, cell, TriangleId(asked.triangle), is_gone)
        .map_err(AskError::Unable)
}

/// Counts wrong pixels. Stops if `is_gone` returns true.
pub(crate) fn measure(
    c: &Coordinator,
    asked: &v1::MeasureRequest,
    is_gone: &(dyn Fn() -> bool + Sync),
) -> Result<v1::MeasureResponse, AskError> {
    let usual = |n: u32, usual: u32| if n == 0 { usual } else { n };
    let asked = v1::MeasureRequest {
        viewpoints: usual(asked.viewpoints, 100),
        resolution: usual(asked.resolution, 128),
        ..*asked
    };
    if asked.viewpoints > 1000 {
        return Err(AskError::Wrong(format!(
            "{} viewpoints exceed the maximum of 1000",
            asked.viewpoints
        )));
    }
    if !(8..=512).contains(&asked.resolution) {
        return Err(AskError::Wrong(format!(
            "a resolution of {} is not between 8 and 512",
            asked.resolution
        )));
    }
    let pixels = u64::from(asked.viewpoints) * CUBE_FACES * u64::from(asked.resolution).pow(2);
    if pixels > MAX_PIXELS {
        return Err(AskError::Wrong(format!(
            "{} viewpoints at resolution {} have {pixels} pixels, but the maximum is {MAX_PIXELS}; \
             request fewer viewpoints or a lower resolution",
            asked.viewpoints, asked.resolution
        )));
    }
    let pvs = open(c, JobId(asked.job))?;
    let (_, scene) = scene(&c.records, &*c.blobs, JobId(asked.job))?;
    c.results
        .queries_of_scenes()?
        .measure(&pvs, scene, &asked, is_gone)
        .map_err(AskError::Unable)
}

impl ResultState {
    /// Returns the program that answers queries which need the scene.
    fn queries_of_scenes(&self) -> Result<&dyn SceneQueries, AskError> {
        let none = || {
            AskError::Unable(
                "the program that contains this coordinator does not support this query".to_owned(),
            )
        };
        self.scene_queries
            .get()
            .map(|queries| &**queries)
            .ok_or_else(none)
    }
}
