//! Tests of damaged files: a truncated or altered file is rejected, and a file with forged checksums never
//! causes a panic.
// Helpers of tests may unwrap as tests do. The exception in clippy's configuration covers only test
// functions.
#![allow(clippy::unwrap_used)]

use proptest::prelude::*;
use sightline_pvs::{Builder, CellTree, Column, Header, Node, Object, Pvs, PvsError};

fn small_file() -> Vec<u8> {
    file_with(vec![], &[])
}

/// Returns four files: without columns, with two columns, with columns and certificates for some cells, and
/// with only certificates.
fn small_files() -> [Vec<u8>; 4] {
    let column = |name: &str, values: [u64; 3]| Column {
        name: name.into(),
        values: values.to_vec(),
    };
    let columns = vec![
        column("rays_uniform", [90, 70_000, u64::MAX]),
        column("bound_lines", [0, 0, 7]),
    ];
    [
        small_file(),
        file_with(columns.clone(), &[]),
        file_with(columns, &[b"seen along this", b""]),
        file_with(vec![], &[b"", b"hidden by that", b"both"]),
    ]
}

fn file_with(columns: Vec<Column>, certificates: &[&[u8]]) -> Vec<u8> {
    let nodes = vec![
        Node::Split { axis: 1, at: 0.5 },
        Node::Leaf,
        Node::Split { axis: 2, at: 0.25 },
        Node::Leaf,
        Node::Leaf,
    ];
    let tree = CellTree::new([[0.0; 3], [1.0; 3]], nodes).unwrap();
    let objects = vec![
        Object {
            name: "wall".into(),
            first: 0,
            count: 60,
            source: None,
        },
        Object {
            name: "tree".into(),
            first: 60,
            count: 40,
            source: None,
        },
    ];
    let info_json = r#"{"resolution":256}"#.into();
    let mut builder = Builder::new(Header {
        triangles: 100,
        method: "aggressive".into(),
        tree,
        objects,
        info_json,
    })
    .unwrap();
    builder.push_cell(&[1, 2, 3, 50, 99], &[3], 0).unwrap();
    builder.push_cell(&[1, 2, 3, 51, 98], &[], 4).unwrap();
    builder
        .push_cell(&(0..100).collect::<Vec<_>>(), &[], 1)
        .unwrap();
    builder.set_columns(columns).unwrap();
    certificates
        .iter()
        .for_each(|c| builder.push_certificate(c).unwrap());
    let mut file = Vec::new();
    builder.finish(&mut file).unwrap();
    file
}

#[test]
fn certificates_round_trip_and_may_be_missing() {
    let [without, columns, some, all] = small_files();
    for file in [without, columns] {
        assert_eq!(Pvs::from_bytes(file).unwrap().certificate(0).unwrap(), None);
    }
    let some = Pvs::from_bytes(some).unwrap();
    let certificate_of = |pvs: &Pvs, cell| pvs.certificate(cell).unwrap().unwrap().to_vec();
    assert_eq!(
        [
            certificate_of(&some, 0),
            certificate_of(&some, 1),
            certificate_of(&some, 2)
        ],
        [b"seen along this".to_vec(), vec![], vec![]]
    );
    assert_eq!(some.columns().unwrap().len(), 2);
    let all = Pvs::from_bytes(all).unwrap();
    assert_eq!(
        [
            certificate_of(&all, 0),
            certificate_of(&all, 1),
            certificate_of(&all, 2)
        ],
        [vec![], b"hidden by that".to_vec(), b"both".to_vec()]
    );
    assert!(all.columns().unwrap().is_empty());
    assert!(matches!(all.certificate(3), Err(PvsError::NoCell { .. })));
}

#[test]
fn rejects_every_altered_byte() {
    for file in small_files() {
        assert!(Pvs::from_bytes(file.clone()).is_ok());
        for at in 0..file.len() {
            // The flip 0x0f turns 7 sections into 8, and 0x0e turns 7 into 9.
            for flip in [0x01, 0x0e, 0x0f, 0x80, 0xff] {
                let mut altered = file.clone();
                altered[at] ^= flip;
                assert!(
                    Pvs::from_bytes(altered).is_err(),
                    "byte {at} of {} changed by {flip:#x}",
                    file.len()
                );
            }
        }
    }
}

#[test]
fn rejects_every_truncation() {
    for file in small_files() {
        for keep in 0..file.len() {
            assert!(
                Pvs::from_bytes(&file[..keep]).is_err(),
                "{keep} of {} bytes",
                file.len()
            );
        }
        let mut longer = file.clone();
        longer.push(0);
        assert!(matches!(
            Pvs::from_bytes(longer),
            Err(PvsError::Length { .. })
        ));
    }
}

#[test]
fn errors_report_altered_section_count() {
    for file in small_files() {
        for sections in (0..=10).chain([u8::MAX]).filter(|&n| n != file[12]) {
            let mut altered = file.clone();
            altered[12] = sections;
            let error = Pvs::from_bytes(altered.clone()).unwrap_err();
            assert!(
                matches!(error, PvsError::Checksum { section: "header" }),
                "{sections}: {error}"
            );
            seal(&mut altered);
            let error = Pvs::from_bytes(altered).unwrap_err();
            assert!(
                matches!(
                    error,
                    PvsError::Malformed {
                        section: "header",
                        ..
                    }
                ),
                "{sections}: {error}"
            );
        }
    }
    // This table reaches beyond the end of the file.
    let [_, file, ..] = small_files();
    assert!(matches!(
        Pvs::from_bytes(&file[..220]),
        Err(PvsError::Length {
            expected: 232,
            actual: 220
        })
    ));
}

/// An empty section of columns would be a second form of a file without columns.
#[test]
fn rejects_empty_column_section() {
    let [without, with, ..] = small_files();
    let start = u64::from_le_bytes(with[216..224].try_into().unwrap()) as usize;
    assert_eq!(start, without.len() + 24);
    for columns in [&[][..], &[0; 4]] {
        let mut file = with[..start].to_vec();
        file.extend(columns);
        let length = file.len() as u64;
        file[16..24].copy_from_slice(&length.to_le_bytes());
        file[224..232].copy_from_slice(&(columns.len() as u64).to_le_bytes());
        seal(&mut file);
        let error = Pvs::from_bytes(file).unwrap_err();
        assert!(
            matches!(
                error,
                PvsError::Malformed {
                    section: "columns",
                    ..
                }
            ),
            "{error}"
        );
    }
}

#[test]
fn errors_report_other_formats_and_versions() {
    assert!(matches!(
        Pvs::from_bytes(&b"solid cube"[..]),
        Err(PvsError::NotPvs)
    ));
    assert!(matches!(Pvs::from_bytes(&b""[..]), Err(PvsError::NotPvs)));
    let mut newer = small_file();
    newer[8] = 3;
    assert!(matches!(
        Pvs::from_bytes(newer),
        Err(PvsError::Version { found: 3, known: 2 })
    ));
}

/// Overwrites the checksums with the checksums of the current contents.
fn seal(file: &mut [u8]) {
    // If the number of sections is impossible, the reader checks the header as one of seven sections.
    let table_end = match file[12..16] {
        [sections @ 8..=9, 0, 0, 0] => 40 + usize::from(sections) * 24,
        _ => 208,
    };
    for entry in (40..table_end).step_by(24) {
        let number = |at: usize| u64::from_le_bytes(file[at..at + 8].try_into().unwrap());
        let (start, length) = (number(entry + 8) as usize, number(entry + 16) as usize);
        if let Some(section) = start
            .checked_add(length)
            .and_then(|end| file.get(start..end))
        {
            let crc = crc32c::crc32c(section).to_le_bytes();
            file[entry + 4..entry + 8].copy_from_slice(&crc);
        }
    }
    let crc =
        crc32c::crc32c_append(crc32c::crc32c(&file[..36]), &file[40..table_end]).to_le_bytes();
    file[36..40].copy_from_slice(&crc);
}

/// Opens a file and reads all of its contents. The ids of every set that can be read must ascend and be below
/// N.
fn read_all(file: Vec<u8>) -> bool {
    let Ok(pvs) = Pvs::from_bytes(file) else {
        return false;
    };
    let mut ids = Vec::new();
    // Opening has checked the columns completely.
    for column in pvs.columns().unwrap() {
        assert_eq!(column.values.len(), pvs.cells() as usize);
    }
    let mut whole = true;
    for cell in 0..pvs.cells() {
        pvs.certificate(cell).unwrap();
        for read in [Pvs::visible, Pvs::undecided] {
            match read(&pvs, cell, &mut ids) {
                Ok(()) => {
                    assert!(ids.windows(2).all(|w| w[0] < w[1]));
                    assert!(ids.last().is_none_or(|&last| last < pvs.triangle_count()));
                }
                Err(_) => whole = false,
            }
        }
        whole &= pvs.visible_objects(cell, &mut ids).is_ok() && pvs.visible_bytes(cell).is_ok();
    }
    whole
}

#[test]
fn forged_files_do_not_panic() {
    for file in small_files() {
        assert!(read_all(file.clone()));
        let mut refused = 0;
        for at in 8..file.len() {
            // N itself (bytes 24…27) may have any value if the objects agree with it. They do not agree here.
            for flip in [0x01, 0x02, 0x0f, 0x10, 0x80, 0xff] {
                let mut altered = file.clone();
                altered[at] ^= flip;
                seal(&mut altered);
                refused += u32::from(!read_all(altered));
            }
        }
        assert!(
            refused > 600,
            "{refused} of {} were refused",
            (file.len() - 8) * 6
        );
    }
}

proptest! {
    #[test]
    fn scrambled_files_do_not_panic(changes in proptest::collection::vec((8usize..1000, any::<u8>()), 1..8)) {
        for mut file in small_files() {
            let length = file.len();
            for &(at, value) in &changes {
                file[8 + at % (length - 8)] = value;
            }
            seal(&mut file);
            read_all(file);
        }
    }

    #[test]
    fn scrambled_columns_do_not_panic(
        changes in proptest::collection::vec((0usize..1000, any::<u8>()), 1..8),
    ) {
        let [without, mut file, ..] = small_files();
        let start = without.len() + 24;
        let length = file.len();
        for (at, value) in changes {
            file[start + at % (length - start)] = value;
        }
        seal(&mut file);
        read_all(file);
    }

    #[test]
    fn rejects_random_bytes(bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
        prop_assert!(Pvs::from_bytes(bytes).is_err());
    }
}
