//! The body of the fuzz target `pvs`, which the tests call, too.

use crate::layout::{u32_at, u64_at};
use crate::{Looker, Pvs, View};

/// The maximum number of triangles, items and cells of a file that is read cell by cell. This limit bounds
/// the time of a run.
const MOST: u32 = 1 << 12;

/// Opens bytes as a result, first unchanged and then with corrected checksums. Reads the contents of every
/// section of the corrected file. Returns true if the corrected bytes are a result.
///
/// # Panics
/// Panics if the ids of a set do not ascend or if an id is too large. No input may cause a panic.
pub fn pvs(bytes: &[u8]) -> bool {
    let _ = Pvs::from_bytes(bytes);
    let mut sealed = bytes.to_vec();
    seal(&mut sealed);
    let Ok(pvs) = Pvs::from_bytes(sealed) else {
        return false;
    };
    if pvs.triangle_count() <= MOST && pvs.cells() <= MOST && pvs.item_count() <= MOST {
        read(&pvs);
    }
    true
}

/// Reads all data that a result offers.
fn read(pvs: &Pvs) {
    let triangles = pvs.triangle_count();
    let ascending = |ids: &[u32], below: u32| {
        assert!(ids.windows(2).all(|w| w[0] < w[1]) && ids.last().is_none_or(|&last| last < below));
    };
    let mut ids = Vec::new();
    let mut bits = vec![0; (triangles as usize).div_ceil(64)];
    for cell in 0..pvs.cells() {
        for read in [Pvs::visible, Pvs::undecided] {
            if read(pvs, cell, &mut ids).is_ok() {
                ascending(&ids, triangles);
            }
        }
        for read in [Pvs::visible_items, Pvs::undecided_items] {
            if read(pvs, cell, &mut ids).is_ok() {
                ascending(&ids, pvs.item_count());
            }
        }
        for read in [Pvs::visible_objects, Pvs::undecided_objects] {
            if read(pvs, cell, &mut ids).is_ok() {
                ascending(&ids, pvs.objects().len() as u32);
            }
        }
        let mut runs = Vec::new();
        if pvs.visible_runs(cell, &mut runs).is_ok() && pvs.visible_bits(cell, &mut bits).is_ok() {
            let of_runs: u32 = runs.iter().map(|run| run.end - run.start).sum();
            assert_eq!(
                of_runs,
                bits.iter().map(|word| word.count_ones()).sum::<u32>()
            );
        }
        let _ = (
            pvs.visible_bytes(cell),
            pvs.contributions(cell),
            pvs.certificate(cell),
        );
        let _ = (
            pvs.is_set_aside(cell),
            pvs.is_reached(cell),
            pvs.sees(cell, 0),
            pvs.sees(0, cell),
        );
        if let Some([min, max]) = pvs.cell_bounds(cell) {
            let middle = std::array::from_fn(|k| f32::midpoint(min[k], max[k]));
            let _ = (pvs.find_cell(middle), pvs.sees_box(cell, min, max));
        }
    }
    for item in 0..=pvs.item_count() {
        pvs.item_triangles(item, &mut ids);
        ascending(&ids, triangles);
    }
    let _ = (
        pvs.columns(),
        pvs.cell_pairs().map(|_| ()),
        pvs.pair_bytes(),
        pvs.file_bytes(),
    );
    let Ok(Some(mut looker)) = Looker::new(pvs) else {
        return;
    };
    let [min, max] = pvs.tree().view_box();
    for part in [0.1, 0.5, 0.9] {
        let eye = std::array::from_fn(|k| {
            f64::from(min[k]) + part * (f64::from(max[k]) - f64::from(min[k]))
        });
        for (direction, up) in [
            ([1.0, 0.2, 0.1], [0.0, 0.0, 1.0]),
            ([-0.1, -1.0, 0.3], [1.0, 0.0, 0.0]),
        ] {
            if let Ok(Some(_)) = looker.look(&View {
                eye,
                direction,
                up,
                fov: [100.0, 70.0],
            }) {
                ascending(looker.visible(), triangles);
            }
        }
    }
}

/// Corrects the checksums of a file. Leaves bytes unchanged that are shorter than a header and its table.
pub fn seal(file: &mut [u8]) {
    let Some(sections) = file.get(12..16).map(|word| u32_at(word, 0)) else {
        return;
    };
    let table_end = 40 + sections.min(32) as usize * 24;
    if file.len() < table_end {
        return;
    }
    for entry in (40..table_end).step_by(24) {
        let [start, length] =
            [8, 16].map(|at| usize::try_from(u64_at(file, entry + at)).unwrap_or(usize::MAX));
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
