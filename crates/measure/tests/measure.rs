//! Tests of the measures of known images.

// Helpers of tests may unwrap as tests do. The exception in clippy's configuration covers only test
// functions.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;

use glam::Vec3;
use sightline_measure::{
    MeasureError, PathReport, Report, Viewpoints, WorstFrameOptions, images, measure,
};
use sightline_numbers::ids::CellIndex;
use sightline_pvs::{Builder, CellTree, Header, Node, Object, Pvs};
use sightline_trace::{CubeImage, CubeRenderer, SKY, TracerError, VisibilitySample};

const N: u32 = 10;
/// The number of triangles of the result. Only 0…9 are visible from the cell x < 1, and only 0…4 from the
/// cell x ≥ 1.
const TRIANGLES: u32 = 20;

/// A renderer that shows a handmade image for each whole x coordinate.
struct Fake(BTreeMap<i32, Vec<u32>>);

impl CubeRenderer for Fake {
    fn samples(&self, _: &[Vec3]) -> Result<Vec<VisibilitySample>, TracerError> {
        Err(TracerError::Unavailable("images only".into()))
    }

    fn image(&self, point: Vec3) -> Result<CubeImage, TracerError> {
        match self.0.get(&(point.x as i32)) {
            Some(ids) => Ok(CubeImage {
                resolution: N,
                ids: ids.clone(),
            }),
            None => Err(TracerError::Failed {
                profile: "fake".into(),
                reason: "no image".into(),
            }),
        }
    }
}

fn pvs() -> Pvs {
    let nodes = vec![Node::Split { axis: 0, at: 1.0 }, Node::Leaf, Node::Leaf];
    let tree = CellTree::new([[0.0; 3], [100.0, 1.0, 1.0]], nodes).unwrap();
    let objects = vec![Object {
        name: "all".into(),
        first: 0,
        count: TRIANGLES,
        source: None,
    }];
    let header = Header {
        triangles: TRIANGLES,
        method: "aggressive".into(),
        tree,
        objects,
        info_json: "{}".into(),
    };
    let mut builder = Builder::new(header).unwrap();
    builder
        .push_cell(&(0..10).collect::<Vec<_>>(), &[], 0)
        .unwrap();
    builder
        .push_cell(&(0..5).collect::<Vec<_>>(), &[], 0)
        .unwrap();
    let mut file = Vec::new();
    builder.finish(&mut file).unwrap();
    Pvs::from_bytes(file).unwrap()
}

fn at(face: u32, x: u32, y: u32) -> usize {
    ((face * N + y) * N + x) as usize
}

/// Returns an image of triangle 0, with sky on face 5 and some pixels of other triangles.
fn image(pixels: &[(usize, u32)]) -> Vec<u32> {
    let mut ids = vec![0; (6 * N * N) as usize];
    ids[at(5, 0, 0)..].fill(SKY);
    for &(i, id) in pixels {
        ids[i] = id;
    }
    ids
}

fn run(
    images: Vec<Vec<u32>>,
    is_path: bool,
    options: &WorstFrameOptions,
) -> Result<Report, MeasureError> {
    let points = (0..images.len())
        .map(|i| Vec3::new(i as f32 + 0.5, 0.5, 0.5))
        .collect();
    let fake = Fake((0..).zip(images).collect());
    measure(
        &fake,
        &pvs(),
        &Viewpoints {
            points,
            weights: Vec::new(),
            is_path,
        },
        options,
        &mut |_, _| true,
    )
}

#[test]
fn known_images_give_known_measures() {
    let report = run(
        vec![
            // In cell 0, 9 is visible, and 10 and 11 are not. The wrong pixels are two diagonal ones and a
            // separate one.
            image(&[
                (at(0, 2, 2), 9),
                (at(0, 5, 5), 10),
                (at(0, 6, 6), 10),
                (at(0, 9, 1), 11),
            ]),
            // In cell 1, no pixel is wrong.
            image(&[(at(0, 2, 2), 4)]),
            // In cell 1, 9 is wrong now. The region crosses the edge from face 0 (+x, right border) to face 2
            // (+y, top row).
            image(&[
                (at(0, 8, 3), 9),
                (at(0, 9, 3), 9),
                (at(2, 3, 9), 7),
                (at(2, 3, 8), 7),
                (at(4, 4, 4), 19),
            ]),
            // One pixel is wrong against the sky.
            image(&[(at(5, 0, 0), 6)]),
        ],
        false,
        &WorstFrameOptions {
            images_dir: None,
            turntable: None,
            images: 2,
            worst: 2,
        },
    )
    .unwrap();
    let pixels = 600.0;
    assert_eq!((report.frames, report.resolution), (4, N));
    let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-15, "{a} instead of {b}");
    close(report.mean_error, (3.0 + 5.0 + 1.0) / 4.0 / pixels);
    close(report.p99_error, 5.0 / pixels);
    close(report.max_error, 5.0 / pixels);
    close(report.mean_regions, (3.0 + 0.0 + 2.0 + 1.0) / 4.0);
    close(report.mean_max_region, (1.0 + 4.0 + 1.0) / 3.0 / pixels);
    close(report.max_region, 4.0 / pixels);
    assert_eq!(report.frames_with_error, 3);
    assert_eq!(report.cells_visited, 2);
    assert_eq!(report.triangles_seen, 8, "0 4 6 7 9 10 11 19");
    assert_eq!(report.path, None);
    assert_eq!(
        report.worst.iter().map(|w| w.frame).collect::<Vec<_>>(),
        [2, 0]
    );
    assert_eq!(
        (
            report.worst[0].wrong_triangles,
            report.worst[0].cell,
            report.worst[0].regions
        ),
        (3, CellIndex(1), 2)
    );
    assert_eq!(report.worst[0].viewpoint, [2.5, 0.5, 0.5]);
    assert_eq!(report.worst[0].image, None);
}

#[test]
fn report_has_documented_keys() {
    let report = run(vec![image(&[])], false, &WorstFrameOptions::default()).unwrap();
    let json = serde_json::to_value(&report).unwrap();
    for key in [
        "frames",
        "resolution",
        "mean_error",
        "p99_error",
        "max_error",
        "mean_regions",
        "mean_max_region",
        "max_region",
    ] {
        assert!(json[key].is_number(), "{key}");
    }
    assert_eq!(json["max_error"], 0.0);
    assert_eq!(json["mean_max_region"], 0.0);
    assert!(json.get("path").is_none());
}

#[test]
fn path_report_counts_durations_of_errors() {
    let wrong = |ids: &[u32]| {
        let pixels: Vec<_> = ids
            .iter()
            .enumerate()
            .map(|(i, &id)| (at(1, i as u32 * 2, 0), id))
            .collect();
        image(&pixels)
    };
    let images = vec![
        wrong(&[]),
        wrong(&[12, 9]),
        wrong(&[12]),
        wrong(&[12, 15]),
        wrong(&[9]),
    ];
    let report = run(images, true, &WorstFrameOptions::default()).unwrap();
    assert_eq!(
        report.path,
        Some(PathReport {
            errors: 4,
            mean_frames: 6.0 / 4.0,
            max_frames: 3
        })
    );
}

#[test]
fn progress_ends_at_all_frames() {
    let fake = Fake((0..70).map(|i| (i, image(&[]))).collect());
    let points = (0..70)
        .map(|i| Vec3::new(i as f32 + 0.5, 0.5, 0.5))
        .collect();
    let mut told = Vec::new();
    let views = Viewpoints {
        points,
        weights: Vec::new(),
        is_path: false,
    };
    let mut tell = |done, total| {
        told.push((done, total));
        true
    };
    measure(
        &fake,
        &pvs(),
        &views,
        &WorstFrameOptions::default(),
        &mut tell,
    )
    .unwrap();
    assert_eq!(told.last(), Some(&(70, 70)));
    assert!(told.is_sorted() && told.len() > 1, "{told:?}");
    let stopped = measure(
        &fake,
        &pvs(),
        &views,
        &WorstFrameOptions::default(),
        &mut |_, _| false,
    )
    .unwrap_err();
    assert!(
        matches!(
            stopped,
            MeasureError::Stopped {
                done: 1..70,
                total: 70
            }
        ),
        "{stopped}"
    );
}

#[test]
fn rejects_invalid_views_and_images() {
    let one = |x: f32| Viewpoints {
        points: vec![Vec3::new(x, 0.5, 0.5)],
        weights: Vec::new(),
        is_path: false,
    };
    let go = |ids: Vec<u32>, views: &Viewpoints| {
        let fake = Fake(BTreeMap::from([(0, ids)]));
        measure(
            &fake,
            &pvs(),
            views,
            &WorstFrameOptions::default(),
            &mut |_, _| true,
        )
        .unwrap_err()
    };
    assert!(matches!(
        go(image(&[]), &one(-1.0)),
        MeasureError::Outside { frame: 0, .. }
    ));
    assert!(matches!(
        go(image(&[]), &one(7.0)),
        MeasureError::Backend(_)
    ));
    assert!(matches!(
        go(image(&[(3, 20)]), &one(0.5)),
        MeasureError::OtherScene {
            id: 20,
            triangles: 20
        }
    ));
    assert!(matches!(
        go(vec![0; 7], &one(0.5)),
        MeasureError::ImageSize { pixels: 7, .. }
    ));
    let none = Viewpoints {
        points: vec![],
        weights: Vec::new(),
        is_path: false,
    };
    assert!(matches!(go(image(&[]), &none), MeasureError::NoViewpoints));
}

#[test]
fn images_show_seen_green_wrong_red_and_sky_black() {
    let dir = tempfile::tempdir().unwrap();
    let options = WorstFrameOptions {
        images_dir: Some(dir.path().join("new/images")),
        turntable: Some(1),
        images: 1,
        worst: 1,
    };
    let report = run(
        vec![image(&[
            (at(0, 0, 0), 10),
            (at(3, 0, 0), 10),
            (at(3, 1, 0), 3),
        ])],
        false,
        &options,
    )
    .unwrap();
    let path = report.worst[0].image.as_ref().unwrap();
    assert!(
        path.ends_with("new/images/worst_01_frame_000000.png"),
        "{}",
        path.display()
    );
    // The animation shows one turn around the viewpoint.
    let film = std::fs::File::open(dir.path().join("new/images/worst_turntable.png")).unwrap();
    let film = png::Decoder::new(std::io::BufReader::new(film))
        .read_info()
        .unwrap();
    assert_eq!(film.info().animation_control().unwrap().num_frames, 48);

    let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut rgb = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut rgb).unwrap();
    assert_eq!((info.width, info.height), (3 * N, 2 * N));
    let pixel = |x: u32, y: u32| -> [u8; 3] {
        let i = ((y * 3 * N + x) * 3) as usize;
        [rgb[i], rgb[i + 1], rgb[i + 2]]
    };
    let is = |found: [u8; 3], base: [u8; 3]| {
        found.iter().zip(base).all(|(&f, b)| {
            u32::from(f) * 100 + 100 > u32::from(b) * 80 && u32::from(f) * 100 <= u32::from(b) * 120
        })
    };
    // Face 0 (+x) is at the upper left and mirrored, so its pixel (0, 0) is at the lower right.
    assert!(
        is(pixel(N - 1, N - 1), images::WRONG),
        "{:?}",
        pixel(N - 1, N - 1)
    );
    assert!(is(pixel(0, 0), images::SEEN), "{:?}", pixel(0, 0));
    // Face 3 (−y) is at the bottom middle and not mirrored, so its pixel (0, 0) is at the lower left.
    assert!(is(pixel(N, 2 * N - 1), images::WRONG));
    assert!(is(pixel(N + 1, 2 * N - 1), images::SEEN));
    // Another triangle has another shade.
    assert_ne!(pixel(N + 1, 2 * N - 1), pixel(N + 2, 2 * N - 1));
    // Face 5 (−z) is sky.
    assert_eq!(pixel(3 * N - 1, 2 * N - 1), [0, 0, 0]);
    let red = (0..2 * N)
        .flat_map(|y| (0..3 * N).map(move |x| (x, y)))
        .filter(|&(x, y)| pixel(x, y)[0] > 100)
        .count();
    assert_eq!(red, 2);
}
