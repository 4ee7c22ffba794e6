//! Tests of the whole specification: every value changes the key, and wrong values are rejected by name.

use std::sync::Arc;

use glam::Vec3;
use sightline_numbers::Aabb;
use sightline_proto::v1;
use sightline_viewcells::{KdTree, PartMask, Region, RegionNode};

use super::cells::*;
use super::names::*;
use super::numbers::*;
use super::sampler::*;
use super::*;

fn unit() -> Aabb {
    Aabb::new(Vec3::ZERO, Vec3::ONE)
}

fn grid() -> GridCells {
    GridCells::new(unit(), [4, 3, 2])
        .unwrap()
        .with_tile_cells(TileCells::new(64).unwrap())
        .unwrap()
}

fn known() -> KnownCells {
    KnownCells::Grid(grid())
}

fn boxes() -> BoxCells {
    let tree = KdTree::new(&[0, 3, 3], &[0.5]).unwrap();
    BoxCells::new(unit(), Arc::new(tree)).unwrap()
}

fn mask(cells: [u32; 3]) -> PartMask {
    let mut mask = PartMask::empty(cells);
    mask.mark([3, 2, 1]);
    mask
}

fn region() -> Region {
    Region::new(vec![
        RegionNode::Split(9),
        RegionNode::Inside,
        RegionNode::Outside,
    ])
    .unwrap()
}

fn by_cost(budget: CellBudget, cost: CellCost) -> GridCells {
    let choice = CellsByCost::new(budget, cost);
    grid().with_cells_by_cost(Some(choice)).unwrap()
}

fn few_cells() -> CellBudget {
    CellBudget::Cells(CellCount::new(5).unwrap())
}

fn weighted() -> GridCells {
    let choice = CellsByCost::new(few_cells(), CellCost::Triangles);
    let weights = (0..24).collect();
    let choice = choice.with_weights(weights).unwrap();
    grid().with_cells_by_cost(Some(choice)).unwrap()
}

fn lines(error: f64, stop: Stop, time: Option<u64>) -> Sampler {
    let aim = LineAim::Known {
        cells: known(),
        error: TargetError::new(error).unwrap(),
        stop,
    };
    let time = time.map(|time| TimeBudget::new(time).unwrap());
    Sampler::Lines { aim, time }
}

fn with_cells(cells: KnownCells) -> Visibility {
    Method::aggressive(Sampling::new(Sampler::lines(cells))).into()
}

fn with_sampler(sampler: Sampler) -> Visibility {
    Method::aggressive(Sampling::new(sampler)).into()
}

fn tree<const DEPTH: u32>(budget: u32, depth: u32) -> Adaptive<DEPTH> {
    Adaptive::new(unit(), TriangleBudget::new(budget).unwrap(), depth).unwrap()
}

fn with_tree(budget: u32, depth: u32) -> Visibility {
    let (cells, error) = (tree(budget, depth), TargetError::default());
    with_sampler(Sampler::Lines {
        aim: LineAim::Adaptive { cells, error },
        time: None,
    })
}

fn with_cubes(change: &dyn Fn(&mut CubeParams)) -> Visibility {
    let cells = CubeCells::Grid(CubeGrid::new(unit(), [4, 3, 2]).unwrap());
    let mut params = CubeParams::default();
    change(&mut params);
    with_sampler(Sampler::Cubes { cells, params })
}

fn exact(effort: Effort, certificates: bool) -> Visibility {
    let sampling = Sampling::new(Sampler::lines(known()));
    Method::Exact {
        sampling,
        effort,
        certificates,
    }
    .into()
}

/// Returns tasks that differ from a default task, and from each other, in a single value.
fn tasks() -> Vec<Visibility> {
    let plain = || with_cells(known());
    let wide = Aabb::new(Vec3::ZERO, Vec3::new(1.0, 1.0, 2.0));
    let sampling = |change: &dyn Fn(&mut Sampling)| {
        let mut sampling = Sampling::new(Sampler::lines(known()));
        change(&mut sampling);
        Visibility::from(Method::aggressive(sampling))
    };
    let aggressive = |items, completion| {
        let sampling = Sampling::new(Sampler::lines(known()));
        Visibility::from(Method::Aggressive {
            sampling,
            items,
            completion,
        })
    };
    let change = |change: &dyn Fn(&mut Visibility)| {
        let mut task = plain();
        change(&mut task);
        task
    };
    let at = |viewpoints| {
        with_cells(KnownCells::Grid(
            grid().with_viewpoints(viewpoints).unwrap(),
        ))
    };
    let in_boxes = boxes()
        .with_viewpoints(Viewpoints::new(mask([2, 1, 1]), None))
        .unwrap();
    let few_bytes = CellBudget::Bytes(ByteCount::new(5).unwrap());
    let cube_grid = CubeGrid::new(unit(), [4, 3, 2]).unwrap();
    let chosen_cubes = cube_grid
        .clone()
        .with_cells_by_cost(Some(CellsByCost::new(few_bytes, CellCost::Bytes)))
        .unwrap();
    let marked = cube_grid.with_mask(Arc::new(mask([4, 3, 2]))).unwrap();
    let few = grid().with_tile_cells(TileCells::new(65).unwrap()).unwrap();
    let rays = RayCount::new(5).unwrap();
    vec![
        plain(),
        with_cells(KnownCells::Grid(GridCells::new(unit(), [4, 3, 3]).unwrap())),
        with_cells(KnownCells::Grid(GridCells::new(wide, [4, 3, 2]).unwrap())),
        with_cells(KnownCells::Grid(few)),
        with_cells(KnownCells::Grid(by_cost(few_cells(), CellCost::Triangles))),
        with_cells(KnownCells::Grid(by_cost(few_bytes, CellCost::Triangles))),
        with_cells(KnownCells::Grid(by_cost(few_bytes, CellCost::Objects))),
        with_cells(KnownCells::Grid(weighted())),
        with_sampler(Sampler::cubes(CubeCells::Grid(chosen_cubes))),
        with_cells(KnownCells::Boxes(boxes())),
        with_cells(KnownCells::Boxes(in_boxes)),
        at(Viewpoints::new(mask([4, 3, 2]), None)),
        at(Viewpoints::new(mask([4, 3, 2]), Some(region()))),
        with_tree(5, 6),
        with_tree(6, 6),
        with_tree(5, 7),
        with_sampler(Sampler::guided(known())),
        with_sampler(Sampler::Guided {
            cells: known(),
            rays,
            credit: Crediting::All,
            time: None,
        }),
        with_sampler(Sampler::Guided {
            cells: known(),
            rays: RayCount::default(),
            credit: Crediting::Own,
            time: None,
        }),
        with_sampler(lines(0.01, Stop::Expected, None)),
        with_sampler(lines(1e-4, Stop::Expected, Some(5))),
        with_sampler(lines(1e-4, Stop::Bound(MaxError::new(0.01).unwrap()), None)),
        with_sampler(lines(1e-4, Stop::Share(MinShare::new(0.01).unwrap()), None)),
        with_cubes(&|_| {}),
        with_cubes(&|p| p.resolution = Resolution::new(64).unwrap()),
        with_cubes(&|p| p.measure = ErrorMeasure::Sets),
        with_cubes(&|p| p.error_threshold = ErrorThreshold::new(0.9).unwrap()),
        with_cubes(&|p| p.interior_threshold = InteriorThreshold::new(0.9).unwrap()),
        with_cubes(&|p| p.min_distance = MinDistance::new(0.25).unwrap()),
        with_cubes(&|p| p.solids = false),
        with_cubes(&|p| p.superset = SupersetChoice::On),
        with_sampler(Sampler::cubes(CubeCells::Grid(marked))),
        with_sampler(Sampler::cubes(CubeCells::Adaptive(tree(5, 20)))),
        sampling(&|s| s.tracer = TracerChoice::Gpu),
        sampling(&|s| s.contributions = true),
        aggressive(Granularity::Clusters, Completion::Auto),
        aggressive(Granularity::Objects, Completion::Auto),
        aggressive(Granularity::Triangles, Completion::Off),
        change(&|task| task.far = Some(Length::new(9.0).unwrap())),
        change(&|task| task.pairs = CellToCell::Off),
        change(&|task| task.seed = 4),
        change(&|task| task.up = Some(Up::Y)),
        change(&|task| task.up = Some(Up::Z)),
        exact(Effort::Full, false),
        exact(Effort::Full, true),
        exact(Effort::Bounded, false),
        Method::portals(known()).into(),
        Method::portals(KnownCells::Boxes(boxes())).into(),
        Method::Portals {
            cells: known(),
            time: Some(TimeBudget::new(7).unwrap()),
        }
        .into(),
    ]
}

fn job(task: Visibility) -> JobSpec {
    JobSpec {
        scene: [7; 32],
        task: Task::Visibility(task),
    }
}

fn read(message: &v1::JobSpec) -> Result<JobSpec, SpecError> {
    JobSpec::from_message(message, &SceneFacts::default())
}

#[test]
fn specifications_round_trip_and_every_value_changes_key() {
    let mut jobs: Vec<JobSpec> = tasks().into_iter().map(job).collect();
    jobs.push(JobSpec {
        scene: [8; 32],
        ..jobs[0].clone()
    });
    for job in &jobs {
        assert_eq!(read(&job.to_message()).as_ref(), Ok(job));
    }
    let mut keys: Vec<_> = jobs.iter().map(JobSpec::key).collect();
    keys.sort_unstable();
    keys.dedup();
    assert_eq!(keys.len(), jobs.len());
}

#[test]
fn json_names_fields_values_and_defaults() {
    let json = job(with_cubes(&|p| p.measure = ErrorMeasure::Sets)).to_json();
    assert_eq!(json["scene"], "07".repeat(32));
    let aggressive = &json["visibility"]["aggressive"];
    assert_eq!(aggressive["items"], "triangles");
    let cubes = &aggressive["sampling"]["cubes"];
    assert_eq!(
        (&cubes["measure"], &cubes["superset"]),
        (&"sets".into(), &"auto".into())
    );
    assert_eq!(
        (&cubes["error_threshold"], &cubes["solids"]),
        (&0.1.into(), &true.into())
    );
    assert_eq!(
        cubes["grid"]["view_box"],
        serde_json::json!([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
    );
    assert_eq!(json["visibility"]["cell_to_cell"], "auto");
}

#[test]
fn json_does_not_depend_on_backend() {
    let with = |tracer| {
        let mut sampling = Sampling::new(Sampler::lines(known()));
        sampling.tracer = tracer;
        job(Method::aggressive(sampling).into()).to_json()
    };
    let unasked = with(TracerChoice::Auto);
    assert_eq!(unasked, with(TracerChoice::Cpu));
    assert_eq!(unasked, with(TracerChoice::Gpu));
}

#[test]
fn large_parts_are_removed_from_messages() {
    let marked = grid()
        .with_viewpoints(Viewpoints::new(mask([4, 3, 2]), Some(region())))
        .unwrap();
    for (cells, is_large, is_boxes) in [
        (known(), false, false),
        (KnownCells::Grid(marked), true, false),
        (
            KnownCells::Grid(by_cost(few_cells(), CellCost::Bytes)),
            false,
            false,
        ),
        (KnownCells::Grid(weighted()), true, false),
        (KnownCells::Boxes(boxes()), true, true),
    ] {
        for method in [
            Method::portals(cells.clone()),
            Method::aggressive(Sampling::new(Sampler::guided(cells.clone()))),
            Method::exact(Sampling::new(Sampler::lines(cells)), Effort::Full),
        ] {
            let whole = JobSpec::new([7; 32], method).to_message();
            let mut small = whole.clone();
            assert_eq!(message::has_boxes(&small), is_boxes);
            assert_eq!(message::remove_large_parts(&mut small), is_large);
            assert_eq!(small != whole, is_large);
        }
    }
}

#[test]
fn error_names_options_of_unimplemented_combination() {
    let refused = |task: Visibility| read(&job(task).to_message()).unwrap_err();
    let proved = |cells, far: bool| {
        let sampling = Sampling::new(Sampler::lines(cells));
        let mut task = Visibility::from(Method::Exact {
            sampling,
            effort: Effort::Full,
            certificates: true,
        });
        task.far = far.then(|| Length::new(9.0).unwrap());
        task
    };
    let within = grid()
        .with_viewpoints(Viewpoints::new(mask([4, 3, 2]), Some(region())))
        .unwrap();
    for task in [
        proved(KnownCells::Boxes(boxes()), false),
        proved(KnownCells::Grid(within), false),
        proved(known(), true),
    ] {
        assert_eq!(refused(task).option(), Some("certificates"));
    }
    let chosen = || Sampling::new(Sampler::lines(KnownCells::Grid(weighted())));
    let proofs = Method::Exact {
        sampling: chosen(),
        effort: Effort::Full,
        certificates: true,
    };
    assert_eq!(refused(proofs.into()).option(), Some("certificates"));
    let mut shares = chosen();
    shares.contributions = true;
    let shares = Method::aggressive(shares);
    assert_eq!(refused(shares.into()).option(), Some("contributions"));
    let bounded = with_sampler(Sampler::Lines {
        aim: LineAim::Known {
            cells: KnownCells::Grid(weighted()),
            error: TargetError::default(),
            stop: Stop::Bound(MaxError::new(0.01).unwrap()),
        },
        time: None,
    });
    assert_eq!(refused(bounded).option(), Some("max-error"));
    let many = KnownCells::Grid(GridCells::new(unit(), [33, 32, 32]).unwrap());
    for mut task in [
        Visibility::from(Method::portals(known())),
        with_cells(KnownCells::Boxes(boxes())),
        with_cells(many),
    ] {
        task.pairs = CellToCell::On;
        assert_eq!(refused(task).option(), Some("cell-to-cell"));
    }
}

#[test]
fn error_names_wrong_value() {
    let error = |change: &dyn Fn(&mut v1::Lines)| {
        let mut lines = v1::Lines {
            cells: Some(v1::lines::Cells::Grid(v1::GridCells {
                view_box: vec![0.0, 0.0, 0.0, 1.0, 1.0, 1.0],
                ..v1::GridCells::default()
            })),
            ..v1::Lines::default()
        };
        change(&mut lines);
        let sampling = v1::Sampling {
            sampler: Some(v1::sampling::Sampler::Lines(lines)),
            ..v1::Sampling::default()
        };
        let aggressive = v1::Aggressive {
            sampling: Some(sampling),
            items: None,
            completion: None,
        };
        let task = v1::Visibility {
            method: Some(v1::visibility::Method::Aggressive(aggressive)),
            ..v1::Visibility::default()
        };
        let task = Some(v1::job_spec::Task::Visibility(task));
        let scene = vec![7; 32];
        read(&v1::JobSpec { scene, task }).err()
    };
    let option = |change: &dyn Fn(&mut v1::Lines)| error(change).unwrap().option();
    assert_eq!(error(&|_| {}), None);
    assert_eq!(
        option(&|m| m.target_error = Some(f64::NAN)),
        Some("target-error")
    );
    assert_eq!(option(&|m| m.time_budget_ms = Some(0)), Some("time-budget"));
    let adaptive = |triangle_budget, max_depth| {
        Some(v1::lines::Cells::Adaptive(v1::Adaptive {
            triangle_budget,
            max_depth,
            view_box: vec![0.0, 0.0, 0.0, 1.0, 1.0, 1.0],
        }))
    };
    assert_eq!(
        option(&|m| m.cells = adaptive(None, None)),
        Some("triangle-budget")
    );
    assert_eq!(
        option(&|m| m.cells = adaptive(Some(5), Some(13))),
        Some("max-depth")
    );
    let bounded = |m: &mut v1::Lines| {
        m.cells = adaptive(Some(5), None);
        m.stop = Some(v1::lines::Stop::MaxError(0.01));
    };
    assert!(
        error(&bounded)
            .unwrap()
            .to_string()
            .contains("adaptive tree")
    );
    let grid = |change: &dyn Fn(&mut v1::GridCells)| {
        option(&|m| {
            if let Some(v1::lines::Cells::Grid(grid)) = &mut m.cells {
                change(grid);
            }
        })
    };
    assert_eq!(grid(&|m| m.view_box.clear()), Some("view-box"));
    assert_eq!(grid(&|m| m.tile_cells = Some(4097)), Some("block-cells"));
    assert_eq!(grid(&|m| m.x = Some(0)), Some("cells"));
    assert_eq!(grid(&|m| m.viewpoints = vec![1]), Some("viewpoints"));
    let choice = |budget, weights: &[u8]| {
        let weights = weights.to_vec();
        Some(v1::CellsByCost {
            budget,
            weights,
            ..v1::CellsByCost::default()
        })
    };
    let one = Some(v1::cells_by_cost::Budget::CellBudget(1));
    for (weights, option) in [
        (&[][..], None),
        (&[1, 0, 0][..], Some("viewpoints")),
        (&[1, 0, 0, 0][..], Some("viewpoints")),
        (&[0; 512 * 4][..], Some("viewpoints")),
        // 512 cells with the weight 0x00ffff01 have a sum above 32 bits, and with 1 below.
        (&[1, 255, 255, 0].repeat(512)[..], Some("viewpoints")),
        (&[1, 0, 0, 0].repeat(512)[..], None),
    ] {
        let error = error(&|m| {
            if let Some(v1::lines::Cells::Grid(grid)) = &mut m.cells {
                grid.cells_by_cost = choice(one, weights);
            }
        });
        assert_eq!(error.and_then(|e| e.option()), option, "{weights:?}");
    }
    assert_eq!(
        grid(&|m| m.cells_by_cost = choice(None, &[])),
        Some("cell-budget")
    );
    assert_eq!(
        grid(&|m| (m.x, m.cells_by_cost) = (Some(33), choice(one, &[]))),
        Some("fine")
    );
    assert_eq!(
        grid(&|m| (m.x, m.y, m.z, m.tile_cells) = (Some(160), Some(160), Some(160), Some(1))),
        Some("block-cells")
    );
    let long = v1::JobSpec {
        scene: vec![1],
        ..v1::JobSpec::default()
    };
    assert_eq!(read(&long).unwrap_err().option(), Some("scene"));
}

#[test]
fn job_rejects_scene_that_does_not_fit() {
    let facts = SceneFacts {
        triangles: 9,
        ..SceneFacts::default()
    };
    let [masked, culled] =
        [(true, false), (false, true)].map(|(has_masks, is_culled)| SceneFacts {
            has_masks,
            is_culled,
            ..facts
        });
    let lines = job(with_cells(known()));
    let decided = job(exact(Effort::Full, false));
    for scene in [facts, masked, culled] {
        assert_eq!(lines.fits(&scene), Ok(()));
    }
    assert_eq!(decided.fits(&facts), Ok(()));
    assert_eq!(decided.fits(&masked).unwrap_err().option(), Some("method"));
    assert_eq!(decided.fits(&culled).unwrap_err().option(), Some("method"));
    let within = grid()
        .with_viewpoints(Viewpoints::new(mask([4, 3, 2]), Some(region())))
        .unwrap();
    let chosen = job(with_cells(KnownCells::Grid(weighted())));
    let many = SceneFacts {
        triangles: u32::MAX,
        ..facts
    };
    assert_eq!(chosen.fits(&facts), Ok(()));
    assert_eq!(lines.fits(&many), Ok(()));
    assert_eq!(chosen.fits(&many).unwrap_err().option(), Some("fine"));
    let foreign = job(with_cells(KnownCells::Grid(within)));
    assert_eq!(
        foreign.fits(&facts).unwrap_err().option(),
        Some("viewpoints")
    );
    assert_eq!(
        foreign.fits(&SceneFacts {
            triangles: 10,
            ..facts
        }),
        Ok(())
    );
}

#[test]
fn job_rejects_cells_thinner_than_rounding_of_lines() {
    // A box of two metres at five million metres: five steps of 32-bit coordinates.
    let far = |wide: f32| Aabb::new(Vec3::new(5e6, 0.0, 0.0), Vec3::new(5e6 + wide, wide, wide));
    let cells = |wide| KnownCells::Grid(GridCells::new(far(wide), [8; 3]).unwrap());
    let sampling = |wide| Sampling::new(Sampler::lines(cells(wide)));
    let displacement = |method: Method| Visibility::from(method).rounding_displacement();
    let thin = Method::aggressive(sampling(16.0));
    let error = displacement(thin.clone()).unwrap_err().to_string();
    assert!(error.contains("2.00e0 wide along x"), "{error}");
    assert!(PlannedJob::new(JobSpec::new([7; 32], thin)).is_err());
    let cubes = CubeCells::Grid(CubeGrid::new(far(16.0), [8; 3]).unwrap());
    let by_cubes = Method::aggressive(Sampling::new(Sampler::cubes(cubes)));
    assert_eq!(displacement(by_cubes), Ok(0.0));
    assert_eq!(
        displacement(Method::exact(sampling(16.0), Effort::Full)),
        Ok(0.0)
    );
    let part = displacement(Method::aggressive(sampling(160.0))).unwrap();
    assert!((0.2..0.3).contains(&part), "{part}");
    // The tree is halved along each axis, as an adaptive tree always is.
    let tree = |wide| {
        let budget = TriangleBudget::new(5).unwrap();
        let cells = Adaptive::new(far(wide), budget, 6).unwrap();
        let error = TargetError::default();
        let aim = LineAim::Adaptive { cells, error };
        displacement(Method::aggressive(Sampling::new(Sampler::Lines {
            aim,
            time: None,
        })))
    };
    assert!(tree(8.0).is_err() && tree(16.0).is_ok());
}
