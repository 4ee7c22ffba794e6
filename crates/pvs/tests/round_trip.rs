//! Tests that a reader returns the contents that the builder received, for any tree and any sets.
// Helpers of tests may unwrap as tests do. The exception in clippy's configuration covers only test
// functions.
#![allow(clippy::unwrap_used)]

use proptest::prelude::*;
use sightline_pvs::{Builder, CellTree, Column, Header, Node, Object, Pvs, PvsError, SET_ASIDE};

/// Creates a tree of `cells` leaves. Each split puts `shape[i]` (in 256ths) of its cells below its plane.
fn tree(cells: usize, shape: &[u8]) -> CellTree {
    fn grow(cells: usize, bounds: [[f32; 3]; 2], shape: &[u8], nodes: &mut Vec<Node>) {
        if cells == 1 {
            return nodes.push(Node::Leaf);
        }
        let i = nodes.len();
        let axis = i % 3;
        let at = (bounds[0][axis] + bounds[1][axis]) / 2.0;
        nodes.push(Node::Split {
            axis: axis as u8,
            at,
        });
        let below = (1 + (cells - 1) * usize::from(shape[i % shape.len()]) / 256).min(cells - 1);
        let (mut lower, mut upper) = (bounds, bounds);
        lower[1][axis] = at;
        upper[0][axis] = at;
        grow(below, lower, shape, nodes);
        grow(cells - below, upper, shape, nodes);
    }
    let bounds = [[0.0; 3], [1.0; 3]];
    let mut nodes = Vec::new();
    grow(cells, bounds, shape, &mut nodes);
    CellTree::new(bounds, nodes).unwrap()
}

fn header(triangles: u32, tree: CellTree, sizes: &[u32]) -> Header {
    let mut objects: Vec<Object> = Vec::new();
    let mut first = 0;
    for (i, &size) in sizes.iter().enumerate() {
        let count = size.min(triangles - first);
        objects.push(Object {
            name: format!("part {i} ü"),
            first,
            count,
            source: None,
        });
        first += count;
    }
    objects.push(Object {
        name: String::new(),
        first,
        count: triangles - first,
        source: None,
    });
    Header {
        triangles,
        method: "aggressive".into(),
        tree,
        objects,
        info_json: r#"{"seed":1}"#.into(),
    }
}

type Cell = (Vec<u32>, Vec<u32>, u32);

fn build(header: Header, cells: &[Cell]) -> Vec<u8> {
    build_with(header, cells, &[])
}

fn build_with(header: Header, cells: &[Cell], columns: &[Column]) -> Vec<u8> {
    let mut builder = Builder::new(header).unwrap();
    builder.set_columns(columns.to_vec()).unwrap();
    for (visible, undecided, flags) in cells {
        builder.push_cell(visible, undecided, *flags).unwrap();
    }
    let mut file = Vec::new();
    let stats = builder.finish(&mut file).unwrap();
    assert_eq!(stats.file_bytes, file.len() as u64);
    assert_eq!(stats.column_bytes == 0, columns.is_empty());
    assert_eq!(stats.certificate_bytes, 0);
    assert_eq!(
        stats.visible_ids,
        cells.iter().map(|c| c.0.len() as u64).sum::<u64>()
    );
    assert_eq!(
        stats.undecided_ids,
        cells.iter().map(|c| c.1.len() as u64).sum::<u64>()
    );
    file
}

/// Returns a strategy for cells that resemble each other: a common base with a few ids flipped, some of them
/// undecided. A few cells have all ids.
fn cells(triangles: u32) -> impl Strategy<Value = Vec<Cell>> {
    let base = proptest::collection::vec(any::<bool>(), triangles as usize);
    let flips = proptest::collection::vec((0..triangles.max(1), any::<bool>()), 0..20);
    let per_cell = proptest::collection::vec((flips, 0u8..10), 1..24);
    (base, per_cell).prop_map(move |(base, per_cell)| {
        let cell = |(flips, kind): (Vec<(u32, bool)>, u8)| {
            if kind == 0 {
                return (
                    (0..triangles).collect(),
                    (0..triangles).collect(),
                    SET_ASIDE | 0x100,
                );
            }
            let mut bits = base.clone();
            let mut open = std::collections::BTreeSet::new();
            for (id, undecided) in flips {
                if let Some(bit) = bits.get_mut(id as usize) {
                    *bit ^= true;
                    if undecided {
                        open.insert(id);
                    }
                }
            }
            let visible: Vec<u32> = (0..triangles).filter(|&i| bits[i as usize]).collect();
            let undecided = open.into_iter().filter(|&i| bits[i as usize]).collect();
            (visible, undecided, 0)
        };
        per_cell.into_iter().map(cell).collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn reader_returns_builder_input(
        sets in (0u32..300).prop_flat_map(|n| (Just(n), cells(n))),
        shape in proptest::collection::vec(any::<u8>(), 1..6),
        sizes in proptest::collection::vec(0u32..40, 0..12),
        counts in proptest::collection::vec((any::<u64>(), 0u32..64), 0..4),
    ) {
        let (triangles, cells) = sets;
        let tree = tree(cells.len(), &shape);
        let header = header(triangles, tree.clone(), &sizes);
        let columns: Vec<Column> = counts
            .iter()
            .enumerate()
            .map(|(i, &(seed, shift))| Column {
                name: format!("count {i} ü"),
                values: (0..cells.len() as u64).map(|c| seed.wrapping_mul(2 * c + 1) >> shift).collect(),
            })
            .collect();
        let file = build_with(header.clone(), &cells, &columns);
        let again = build_with(header.clone(), &cells, &columns);
        prop_assert_eq!(&file, &again, "the same input gives the same bytes");

        let pvs = Pvs::from_bytes(file).unwrap();
        prop_assert_eq!(pvs.triangle_count(), triangles);
        prop_assert_eq!(pvs.cells() as usize, cells.len());
        prop_assert_eq!(pvs.tree(), &tree);
        prop_assert_eq!(pvs.objects(), &header.objects[..]);
        prop_assert_eq!(pvs.info_json(), &header.info_json);
        prop_assert_eq!(pvs.method(), &header.method);
        prop_assert_eq!(pvs.columns().unwrap(), columns);
        let mut ids = vec![7; 3];
        let mut runs = Vec::new();
        let mut bits = vec![u64::MAX; triangles.div_ceil(64) as usize];
        for (i, (visible, undecided, flags)) in cells.iter().enumerate() {
            let cell = i as u32;
            pvs.visible(cell, &mut ids).unwrap();
            prop_assert_eq!(&ids, visible);
            pvs.visible_runs(cell, &mut runs).unwrap();
            prop_assert!(runs.windows(2).all(|w| w[0].end < w[1].start));
            prop_assert_eq!(&runs.iter().cloned().flatten().collect::<Vec<_>>(), visible);
            pvs.visible_bits(cell, &mut bits).unwrap();
            let is_set = |b: &u32| bits[*b as usize / 64] >> (b % 64) & 1 == 1;
            let set: Vec<u32> = (0..bits.len() as u32 * 64).filter(is_set).collect();
            prop_assert_eq!(&set, visible);
            pvs.undecided(cell, &mut ids).unwrap();
            prop_assert_eq!(&ids, undecided);
            prop_assert_eq!(pvs.flags(cell).unwrap(), *flags);
            prop_assert_eq!(pvs.visible_count(cell).unwrap() as usize, visible.len());
            prop_assert_eq!(pvs.undecided_count(cell).unwrap() as usize, undecided.len());
            let objects = |is_in: &dyn Fn(&Object) -> bool| -> Vec<u32> {
                (0..).zip(&header.objects).filter(|(_, o)| is_in(o)).map(|(i, _)| i).collect()
            };
            let holds = |o: &Object, id: &u32| o.first <= *id && *id < o.first + o.count;
            let drawn = |o: &Object| visible.iter().any(|id| holds(o, id));
            let known = |id: &u32| undecided.binary_search(id).is_err();
            let seen = |o: &Object| visible.iter().any(|id| known(id) && holds(o, id));
            pvs.visible_objects(cell, &mut ids).unwrap();
            prop_assert_eq!(&ids, &objects(&drawn));
            pvs.undecided_objects(cell, &mut ids).unwrap();
            prop_assert_eq!(&ids, &objects(&|o| drawn(o) && !seen(o)));
            let [lo, hi] = pvs.cell_bounds(cell).unwrap();
            prop_assert_eq!(pvs.find_cell(std::array::from_fn(|a| (lo[a] + hi[a]) / 2.0)), Some(cell));
            prop_assert_eq!(pvs.find_cell(lo), Some(cell));
        }
        let beyond = cells.len() as u32;
        let no_cell = matches!(pvs.visible(beyond, &mut ids), Err(PvsError::NoCell { .. }));
        prop_assert!(no_cell);
    }
}

proptest! {
    /// Checks that the reader decodes sets over 3·10⁹ triangles without one bit per triangle.
    #[test]
    fn sets_over_billions_of_triangles_round_trip(
        cells in proptest::collection::vec(proptest::collection::btree_set(0u32..40, 0..30), 1..9),
    ) {
        let spread = |k: &u32| (k / 4) * 300_000_000 + k % 4;
        let cells: Vec<Cell> = cells
            .iter()
            .map(|set| set.iter().map(spread).collect::<Vec<u32>>())
            .map(|set| (set.clone(), set.into_iter().filter(|id| id % 3 == 0).collect(), 0))
            .collect();
        let header = header(3_000_000_000, tree(cells.len(), &[128]), &[2, 900_000_000, 1]);
        let pvs = Pvs::from_bytes(build(header.clone(), &cells)).unwrap();
        let mut ids = Vec::new();
        for (cell, (visible, undecided, _)) in (0..).zip(&cells) {
            pvs.visible(cell, &mut ids).unwrap();
            prop_assert_eq!(&ids, visible);
            pvs.undecided(cell, &mut ids).unwrap();
            prop_assert_eq!(&ids, undecided);
            let bounds = sightline_pvs::runs::from_ids(visible);
            prop_assert_eq!(pvs.visible_bounds(cell).unwrap(), bounds);
            let holds = |o: &Object| visible.iter().any(|id| o.first <= *id && id - o.first < o.count);
            let objects: Vec<u32> =
                (0..).zip(&header.objects).filter(|(_, o)| holds(o)).map(|(i, _)| i).collect();
            pvs.visible_objects(cell, &mut ids).unwrap();
            prop_assert_eq!(&ids, &objects);
        }
    }
}

#[test]
fn object_with_visible_triangle_is_not_undecided() {
    // Objects 0..2, 2..4 and 4..9 have one visible and one undecided triangle, two undecided triangles, and
    // none.
    let cell = (vec![0, 1, 2, 3], vec![1, 2, 3], 0);
    let pvs = Pvs::from_bytes(build(header(9, tree(1, &[128]), &[2, 2]), &[cell])).unwrap();
    let mut ids = Vec::new();
    pvs.visible_objects(0, &mut ids).unwrap();
    assert_eq!(ids, [0, 1]);
    pvs.undecided_objects(0, &mut ids).unwrap();
    assert_eq!(ids, [1]);
}

#[test]
fn open_result_survives_truncation_of_its_file() {
    let file = build(
        header(9, tree(2, &[128]), &[4]),
        &[(vec![0, 1, 5], vec![5], 0), (vec![1], vec![], 0)],
    );
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.pvs");
    std::fs::write(&path, &file).unwrap();
    let pvs = Pvs::open(&path).unwrap();
    // A mapped file would end this process with SIGBUS at the next access.
    std::fs::File::create(&path).unwrap();
    let mut ids = Vec::new();
    pvs.visible(0, &mut ids).unwrap();
    assert_eq!(ids, [0, 1, 5]);
    assert!(matches!(Pvs::open(&path), Err(PvsError::NotPvs)));
}

#[test]
fn mapped_file_equals_file_in_memory() {
    let file = build(
        header(9, tree(2, &[128]), &[4]),
        &[(vec![0, 1, 5], vec![5], 0), (vec![1, 8], vec![], 0)],
    );
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.pvs");
    std::fs::write(&path, &file).unwrap();
    let pvs = Pvs::open(&path).unwrap();
    let mut ids = Vec::new();
    pvs.visible(1, &mut ids).unwrap();
    assert_eq!(ids, [1, 8]);
    assert_eq!(pvs.file_bytes()[0], file.len() as u64);
    let bytes = pvs.visible_bytes(1).unwrap();
    assert!(bytes.own <= bytes.path && bytes.path < 40, "{bytes:?}");

    std::fs::write(dir.path().join("empty.pvs"), b"").unwrap();
    assert!(matches!(
        Pvs::open(dir.path().join("empty.pvs")),
        Err(PvsError::NotPvs)
    ));
    let missing = Pvs::open(dir.path().join("none.pvs")).unwrap_err();
    assert!(missing.to_string().contains("none.pvs"), "{missing}");
}

/// Checks that averages save space: eight cells that share 999 of 1000 scattered ids cost little more than
/// one.
#[test]
fn ids_that_cells_share_are_stored_once() {
    let base: Vec<u32> = (0..1000).map(|i| i * 7 + i % 3).collect();
    let cells: Vec<Cell> = (0..8)
        .map(|c| {
            (
                base.iter()
                    .copied()
                    .filter(|&id| id != base[c * 100])
                    .collect(),
                vec![],
                0,
            )
        })
        .collect();
    let eight = build(header(7100, tree(8, &[128]), &[]), &cells).len();
    let one = build(header(7100, tree(1, &[128]), &[]), &cells[..1]).len();
    assert!(
        eight < one + 600,
        "eight cells take {eight} bytes, one takes {one}"
    );
}

#[test]
fn builder_rejects_bad_input() {
    let fresh = || Builder::new(header(10, tree(2, &[128]), &[])).unwrap();
    let why = |visible: &[u32], undecided: &[u32], flags| {
        fresh()
            .push_cell(visible, undecided, flags)
            .unwrap_err()
            .to_string()
    };
    assert!(why(&[3, 3], &[], 0).contains("ascend"));
    assert!(why(&[3, 2], &[], 0).contains("ascend"));
    assert!(why(&[3, 10], &[], 0).contains("no triangle 10"));
    assert!(why(&[3], &[4], 0).contains("triangle 4 is not in"));
    assert!(why(&[3], &[], SET_ASIDE).contains("set aside"));

    let mut builder = fresh();
    builder.push_cell(&[1], &[], 0).unwrap();
    let early = fresh().finish(&mut Vec::new()).unwrap_err();
    assert!(
        matches!(
            early,
            PvsError::CellCount {
                expected: 2,
                pushed: 0
            }
        ),
        "{early}"
    );
    builder.push_cell(&[2], &[], 0).unwrap();
    assert!(matches!(
        builder.push_cell(&[2], &[], 0),
        Err(PvsError::CellCount {
            expected: 2,
            pushed: 3
        })
    ));

    let mut gap = header(10, tree(1, &[0]), &[]);
    gap.objects = vec![Object {
        name: "a".into(),
        first: 1,
        count: 9,
        source: None,
    }];
    assert!(matches!(
        Builder::new(gap.clone()),
        Err(PvsError::Objects { object: 0, .. })
    ));
    gap.objects = vec![Object {
        name: "a".into(),
        first: 0,
        count: 9,
        source: None,
    }];
    assert!(matches!(
        Builder::new(gap),
        Err(PvsError::Objects { object: 1, .. })
    ));
}

#[test]
fn cells_pushed_together_give_same_file() {
    let cells = fixed_cells();
    let header = || header(500, tree(6, &[128, 40]), &[100, 0, 250]);
    let each: Vec<sightline_pvs::Cell<'_>> = cells
        .iter()
        .map(|(visible, undecided, flags)| sightline_pvs::Cell {
            visible,
            undecided,
            flags: *flags,
        })
        .collect();
    let mut together = Builder::new(header()).unwrap();
    together.push_cells(&each[..2]).unwrap();
    // The error names a bad cell by its number among all cells, and the builder adds no cell of that call.
    let bad = sightline_pvs::Cell {
        visible: &[3, 2],
        undecided: &[],
        flags: 0,
    };
    let refused = together.push_cells(&[each[2], bad]).unwrap_err();
    assert!(
        matches!(refused, PvsError::Ids { cell: 3, .. }),
        "{refused}"
    );
    together.push_cells(&each[2..]).unwrap();
    let mut file = Vec::new();
    together.finish(&mut file).unwrap();
    assert_eq!(file, build(header(), &cells));
}

#[test]
fn columns_add_only_their_bytes_and_table_entry() {
    let cells = fixed_cells();
    let header = || header(500, tree(6, &[128, 40]), &[100, 0, 250]);
    let column = |name: &str, value: u64| Column {
        name: name.into(),
        values: vec![value; cells.len()],
    };
    let without = build(header(), &cells);
    let entry = 24;
    // The columns add the count, two lengths and a name per column, and one byte per seven bits of each
    // value.
    let small = [column("rays_uniform", 127)];
    let with = build_with(header(), &cells, &small);
    assert_eq!(with.len(), without.len() + entry + 4 + (8 + 12 + 6));
    let both = [column("rays_uniform", 127), column("bound_lines", 128)];
    let with = build_with(header(), &cells, &both);
    assert_eq!(
        with.len(),
        without.len() + entry + 4 + (8 + 12 + 6) + (8 + 11 + 2 * 6)
    );
    // A reader of sets reads equal bytes from both files.
    let [with, without] = [with, without].map(|file| Pvs::from_bytes(file).unwrap());
    assert_eq!(with.file_bytes()[1..], without.file_bytes()[1..]);
    assert_eq!(with.visible_section(), without.visible_section());
    assert_eq!(with.columns().unwrap(), both);
    assert_eq!(without.columns().unwrap(), []);
}

#[test]
fn columns_can_be_set_repeatedly_at_any_time() {
    let column = |name: &str, values: &[u64]| Column {
        name: name.into(),
        values: values.to_vec(),
    };
    let mut builder = Builder::new(header(10, tree(2, &[128]), &[])).unwrap();
    builder
        .set_columns(vec![column("a", &[1, 2]), column("b", &[3, 4])])
        .unwrap();
    builder.push_cell(&[1], &[], 0).unwrap();
    builder.set_columns(vec![column("c", &[5, 6])]).unwrap();
    builder.push_cell(&[2], &[], 0).unwrap();
    for bad in [
        column("", &[1, 2]),
        column("d", &[1]),
        column(&"d".repeat(65), &[1, 2]),
    ] {
        let error = builder.set_columns(vec![bad.clone()]).unwrap_err();
        assert!(
            matches!(&error, PvsError::Column { name, .. } if *name == bad.name),
            "{error}"
        );
    }
    let twice = builder
        .set_columns(vec![column("d", &[1, 2]), column("d", &[1, 2])])
        .unwrap_err();
    assert!(twice.to_string().contains("\"d\""), "{twice}");
    let mut file = Vec::new();
    builder.finish(&mut file).unwrap();
    // The rejected calls have not changed the columns.
    assert_eq!(
        Pvs::from_bytes(file).unwrap().columns().unwrap(),
        [column("c", &[5, 6])]
    );
}

#[test]
fn finish_reports_full_disk() {
    struct Full;
    impl std::io::Write for Full {
        fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
            Err(std::io::ErrorKind::StorageFull.into())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let mut builder = Builder::new(header(10, tree(1, &[0]), &[])).unwrap();
    builder.push_cell(&[1], &[], 0).unwrap();
    assert!(matches!(builder.finish(&mut Full), Err(PvsError::Write(_))));
}

/// Computes the FNV-1a digest. The CRC-32C of the whole file does not suffice, because the file contains
/// checksums of the same kind, which can cancel a change.
fn digest(file: &[u8]) -> u64 {
    file.iter().fold(0xcbf2_9ce4_8422_2325, |hash, &byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

/// Creates six cells by integer arithmetic, so that their file does not depend on the machine. The last cell
/// is set aside.
fn fixed_cells() -> Vec<Cell> {
    let mut cells: Vec<Cell> = (0..5u32)
        .map(|c| {
            let visible: Vec<u32> = (0..500)
                .filter(|i| (i * i + c * (i / 40)) % 7 < 3)
                .collect();
            let undecided = visible
                .iter()
                .copied()
                .filter(|i| (i + c) % 11 == 0)
                .collect();
            (visible, undecided, c << 8)
        })
        .collect();
    cells.push(((0..500).collect(), vec![], SET_ASIDE));
    cells
}

/// Checks that files without columns are unchanged. The writer from before the introduction of columns gave
/// this length and digest.
#[test]
fn file_without_columns_keeps_its_bytes() {
    let cells = fixed_cells();
    let file = build(header(500, tree(6, &[128, 40]), &[100, 0, 250]), &cells);
    assert_eq!(file[12], 7);
    assert_eq!((file.len(), digest(&file)), (1148, 0xe08b_5a10_1a32_7e3d));
    let decided: Vec<Cell> = cells
        .into_iter()
        .map(|(visible, _, flags)| (visible, vec![], flags))
        .collect();
    let file = build(header(500, tree(6, &[128, 40]), &[100, 0, 250]), &decided);
    assert_eq!((file.len(), digest(&file)), (917, 0xac16_9745_b2c9_8d66));
}
