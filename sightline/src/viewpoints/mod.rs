//! Viewpoints: the conversion from the options of a job to the marks of its cells.

mod outliers;
mod walls;
pub(crate) mod weights;

use std::io::BufReader;
use std::path::Path;
use std::sync::Arc;

use sightline_model::{BoxCells, TracerChoice, Up, Viewpoints};
use sightline_portals::{RegionPlanes, along_walls};
use sightline_scene::{Aabb, Scene, overlap};
use sightline_trace::sight::{SightLineTracer, least_step};
use sightline_trace::{CubeSpec, PreparedScene, Strata};
use sightline_viewcells::{Division, Lattice, Layout, PartMask, Plan, Region};
use sightline_viewpoints::reach::ReachScene;
use sightline_viewpoints::{
    PartPlanes, ViewpointsError, both, boxes, mark_where, mesh, points, reach,
};

pub use self::walls::{Walls, refine, region_of_result, walls_of};
use crate::error::Error;
use crate::observer::{Observer, note, warn};
use crate::options::ViewpointOptions;
use crate::progress::Counter;
use crate::scene::{LoadOptions, SceneSource, read_scene};
use crate::tracers::open_tracer;
use crate::words::plural;

/// Reads a mesh of viewpoints.
fn read_mesh(path: &Path, observer: &dyn Observer) -> Result<Arc<Scene>, Error> {
    let source = SceneSource::File(path.to_owned());
    read_scene(&source, &LoadOptions::default(), observer)
}

impl ViewpointOptions {
    /// Returns the box that the cells divide: the box around all view boxes, without view boxes the box
    /// around the mesh, and without a mesh the scene's bounds.
    pub(crate) fn bounds(&self, scene: &Scene, observer: &dyn Observer) -> Result<Aabb, Error> {
        if let Some(first) = self.view_box.first() {
            return Ok(self.view_box.iter().fold(*first, |all, b| all.union(*b)));
        }
        if let Some(path) = &self.view_mesh {
            let mesh = read_mesh(path, observer)?;
            return Ok(match self.eye_heights {
                Some(heights) => mesh::bounds_above(&mesh, self.axis(), heights),
                None => mesh.bounds(),
            });
        }
        Ok(scene.bounds())
    }

    fn axis(&self) -> usize {
        match self.up.unwrap_or_default() {
            Up::Y => 1,
            Up::Z => 2,
        }
    }

    /// Returns true if the options exclude a part of the view box.
    pub(crate) fn restrict(&self) -> bool {
        self.view_box.len() > 1
            || self.view_mesh.is_some()
            || self.viewpoints.is_some()
            || !self.reachable_from.is_empty()
    }

    /// Returns at most `most` boxes along walls. With --reachable-from, only boxes that contain viewpoints
    /// are marked as reached.
    pub(crate) fn along_walls(
        &self,
        scene: &Arc<Scene>,
        view_box: Aabb,
        most: usize,
        observer: &dyn Observer,
    ) -> Result<BoxCells, Error> {
        if self.view_box.len() > 1 || self.view_mesh.is_some() || self.viewpoints.is_some() {
            return Err(Error::usage(
                "several view boxes, --view-mesh and --viewpoints need a grid of cells: give --cells \
                 NXxNYxNZ, or --reachable-from for boxes along walls"
                    .to_owned(),
            ));
        }
        let mut region = None;
        if !self.reachable_from.is_empty() {
            let (cells, lattice) = whole(view_box)?;
            let parts = PartPlanes::new(&lattice, cells);
            self.with_tracer(scene, &parts, cells, observer, |tracing| {
                reach::check(tracing, &self.reachable_from)
                    .map(drop)
                    .map_err(of_seeds)
            })?;
            let walls = Walls::around(scene, &self.reachable_from, observer)?;
            note(observer, walls.in_words());
            region = walls.region()?;
            if walls.is_open() {
                return Err(Error::input(
                    "boxes along walls with --reachable-from need walls that enclose its points; close the \
                     way out (`sightline portals SCENE --reachable-from x,y,z -o way.glb` draws it), or give \
                     --cells NXxNYxNZ"
                        .to_owned(),
                ));
            }
            if region.is_none() {
                return Err(Error::input(
                    "boxes along walls with --reachable-from need walls that are known to enclose its \
                     points; give --cells NXxNYxNZ"
                        .to_owned(),
                ));
            }
        }
        let reached = region
            .as_ref()
            .map(|region| RegionPlanes::new(region, scene))
            .transpose();
        let reached = reached.map_err(Error::internal)?;
        let is_used = |part: Aabb| reached.as_ref().is_none_or(|reached| reached.meets(part));
        let tree = along_walls(scene, view_box, most, &is_used);
        let boxes = tree.boxes();
        let usage = |e: &dyn std::fmt::Display| Error::usage(e.to_string());
        let cells = BoxCells::new(view_box, Arc::new(tree)).map_err(|e| usage(&e))?;
        let Some(region) = region else {
            note(observer, format!("{} along walls", plural_boxes(boxes)));
            return Ok(cells);
        };
        let mut marks = PartMask::empty([boxes as u32, 1, 1]);
        let (division, lattice) = (cells.cells().division(), cells.cells().lattice());
        for tile in Plan::new(division, lattice, Layout::Blocks(1)).tiles {
            let (min, max) = tile.cell.world(lattice);
            if let Some(number) = division
                .number(lattice, &tile.cell)
                .filter(|_| is_used(Aabb::new(min, max)))
            {
                marks.mark_all(number);
            }
        }
        if marks.reached() == 0 {
            return Err(Error::input(
                "the space that walls enclose around the points of --reachable-from is outside the view \
                 box, so no box contains a viewpoint; enlarge --view-box"
                    .to_owned(),
            ));
        }
        note(
            observer,
            format!(
                "{} along walls, {} of them with viewpoints",
                plural_boxes(boxes),
                marks.reached()
            ),
        );
        cells
            .with_viewpoints(Viewpoints::new(marks, Some(region)))
            .map_err(|e| usage(&e))
    }

    /// Computes the parts of the cells of a grid that contain viewpoints. If `walls` is true and walls
    /// enclose the points of --reachable-from, viewpoints are only in the enclosed region.
    pub(crate) fn viewpoints(
        &self,
        scene: &Arc<Scene>,
        cells: [u32; 3],
        lattice: &Lattice,
        walls: bool,
        observer: &dyn Observer,
    ) -> Result<Viewpoints, Error> {
        if !self.restrict() {
            return Ok(Viewpoints::Everywhere);
        }
        let parts = PartPlanes::new(lattice, cells);
        let mut region = None;
        let mut all: Option<PartMask> = None;
        let mut restrict = |marks: PartMask| {
            all = Some(match all.take() {
                Some(all) => both(&all, &marks),
                None => marks,
            });
        };
        if self.view_box.len() > 1 {
            restrict(boxes::mark(&parts, cells, &self.view_box));
        }
        if let Some(file) = &self.view_mesh {
            let mesh = read_mesh(file, observer)?;
            restrict(match self.eye_heights {
                Some(heights) => mesh::mark_above(&parts, cells, &mesh, self.axis(), heights),
                None => mesh::mark_closed(&parts, cells, &mesh).map_err(|e| of_file(file, &e))?,
            });
        }
        if self.viewpoints.is_some() || !self.reachable_from.is_empty() {
            let (traced, found) = self.with_tracer(scene, &parts, cells, observer, |tracing| {
                self.traced(tracing, &parts, cells, walls, observer)
            })?;
            traced.into_iter().for_each(&mut restrict);
            region = found;
        }
        let Some(marks) = all else {
            return Ok(Viewpoints::Everywhere);
        };
        if marks.reached() == 0 {
            return Err(Error::scene(
                "the options allow no viewpoint in the view box; give fewer of --view-box, --view-mesh, \
                 --viewpoints and --reachable-from",
            ));
        }
        let parts = cells.map(u64::from).iter().product::<u64>() * 64;
        note(
            observer,
            format!(
                "viewpoints: in {} of {}, in {:.1} % of the view box",
                marks.reached(),
                plural(marks.count(), "cell"),
                100.0 * marks.marked() as f64 / parts as f64
            ),
        );
        Ok(Viewpoints::new(marks, region))
    }

    /// Calls `with` with the scene, its parts of cells, and a tracer of free segments.
    fn with_tracer<T>(
        &self,
        scene: &Arc<Scene>,
        parts: &PartPlanes,
        cells: [u32; 3],
        observer: &dyn Observer,
        with: impl FnOnce(&ReachScene<'_>) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let spec = CubeSpec {
            resolution: 256,
            strata: Strata::One,
            keep_pixels: false,
        };
        let (_, backend) = open_tracer(TracerChoice::Auto, scene, spec, observer)?;
        let prepared = PreparedScene::new(Arc::clone(scene))?;
        let sight = SightLineTracer::new(&*backend, prepared.traced()).map_err(Error::internal)?;
        let step = least_step(scene.bounds());
        with(&ReachScene {
            scene,
            sight: &sight,
            parts,
            cells,
            step,
        })
    }

    /// Computes the marks that need a tracer, and the region that walls enclose.
    fn traced(
        &self,
        tracing: &ReachScene<'_>,
        parts: &PartPlanes,
        cells: [u32; 3],
        walls: bool,
        observer: &dyn Observer,
    ) -> Result<(Vec<PartMask>, Option<Region>), Error> {
        let scene = tracing.scene;
        let mut out = Vec::new();
        if let Some(file) = &self.viewpoints {
            let read = read_viewpoints(file)?;
            let all: Vec<[f32; 3]> = read.iter().map(|w| w.point).collect();
            let (marks, outside) = reach::mark_around(tracing, &all, self.reach.unwrap_or(0.0))
                .map_err(|e| of_file(file, &e))?;
            if outside > 0 {
                warn(
                    observer,
                    format!(
                        "{}: {outside} of {} are outside the view box and are skipped",
                        file.display(),
                        plural(all.len(), "viewpoint")
                    ),
                );
            }
            out.push(marks);
        }
        let mut region = None;
        if !self.reachable_from.is_empty() {
            reach::check(tracing, &self.reachable_from).map_err(of_seeds)?;
            if !walls {
                note(
                    observer,
                    "note: certificates and visibility cubes do not support regions between walls, so \
                     viewpoints of --reachable-from are in the parts of cells that rays reach",
                );
            } else {
                let walls = Walls::around(scene, &self.reachable_from, observer)?;
                note(observer, walls.in_words());
                region = walls.region()?;
            }
            out.push(match &region {
                Some(region) => {
                    let reached = RegionPlanes::new(region, scene).map_err(Error::internal)?;
                    mark_where(parts, cells, |part| reached.meets(part))
                }
                None => {
                    let counter = Counter::new("parts of cells reached", observer);
                    let total = cells.map(u64::from).iter().product::<u64>() * 64;
                    let marks = reach::mark_reachable(tracing, &self.reachable_from, &mut |done| {
                        counter.show(done, total);
                    });
                    marks.map_err(of_seeds)?
                }
            });
        }
        Ok((out, region))
    }

    /// Prints a warning for each view box that contains no part of the scene. Without a view box, prints a
    /// note if few triangles stretch the scene's bounds.
    pub(crate) fn warn_of_bounds(&self, scene: &Scene, observer: &dyn Observer) {
        if self.view_box.is_empty() && self.view_mesh.is_none() {
            outliers::note_outliers(scene, observer);
        }
        for view_box in &self.view_box {
            let bounds = scene.bounds();
            let holds = |t| overlap::triangle_touches_box(t, view_box);
            if (0..3).all(|a| view_box.min[a] <= view_box.max[a])
                && !scene.triangles().iter().any(holds)
            {
                warn(
                    observer,
                    format!(
                        "the view box {} to {} holds nothing of the scene, which extends from {} to {}; \
                         give the box in the scene's units and axes",
                        view_box.min, view_box.max, bounds.min, bounds.max
                    ),
                );
            }
        }
    }
}

/// Creates an error about the points of --reachable-from.
fn of_seeds(e: ViewpointsError) -> Error {
    match e {
        ViewpointsError::Backend(e) => Error::internal(e),
        e => Error::input(format!("--reachable-from: {e}")),
    }
}

/// Returns a view box as a grid of one cell.
fn whole(view_box: Aabb) -> Result<([u32; 3], Lattice), Error> {
    let cells = [1; 3];
    let lattice = Division::Grid(cells).lattice(view_box.min, view_box.max);
    lattice
        .map(|lattice| (cells, lattice))
        .map_err(|e| Error::usage(e.to_string()))
}

/// Formats a number of boxes.
fn plural_boxes(boxes: usize) -> String {
    if boxes == 1 {
        "1 box".to_owned()
    } else {
        format!("{boxes} boxes")
    }
}

/// Reads a file of viewpoints.
pub fn read_viewpoints(path: &Path) -> Result<Vec<points::WeightedViewpoint>, Error> {
    let file = std::fs::File::open(path).map_err(|e| {
        Error::input(format!(
            "{} cannot be read: {e}; give a file with a viewpoint `x y z` or `x y z weight` per \
             line",
            path.display()
        ))
    })?;
    points::read(BufReader::new(file)).map_err(|e| of_file(path, &e))
}

fn of_file(path: &Path, e: &ViewpointsError) -> Error {
    Error::input(format!("{}: {e}", path.display()))
}
