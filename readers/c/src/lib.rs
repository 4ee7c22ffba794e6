//! The reader of `.pvs` results for C, and for languages that call C.
//!
//! Several threads may call functions of this library at the same time, also on one result, except
//! `sightline_pvs_close` and `sightline_pvs_free`. No function panics: the functions return an error for
//! unreadable or malformed files.

#![allow(
    unsafe_code,
    reason = "C passes pointers; each function documents its pointers"
)]

use std::ffi::{CStr, CString, c_char};
use std::ptr;

use sightline_pvs::Pvs;

/// An opened result.
pub struct SightlinePvs {
    pvs: Pvs,
    method: CString,
    info: CString,
    names: Vec<CString>,
}

/// Converts text for C. Removes NUL characters, which would end the text early.
fn text(words: &str) -> CString {
    CString::new(words.replace('\0', "")).unwrap_or_default()
}

/// Returns an opened result, or writes the reason of the failure to `error` and returns NULL.
fn opened(pvs: Result<Pvs, sightline_pvs::PvsError>, error: *mut *mut c_char) -> *mut SightlinePvs {
    match pvs {
        Ok(pvs) => {
            let names = pvs
                .objects()
                .iter()
                .map(|object| text(&object.name))
                .collect();
            let (method, info) = (text(pvs.method()), text(pvs.info_json()));
            Box::into_raw(Box::new(SightlinePvs {
                pvs,
                method,
                info,
                names,
            }))
        }
        Err(e) => {
            if !error.is_null() {
                // SAFETY: the caller passes the address of a pointer, or NULL.
                unsafe { *error = text(&e.to_string()).into_raw() };
            }
            ptr::null_mut()
        }
    }
}

/// Opens a result file and checks all of it. Returns NULL if the reader rejects the file, and then writes the
/// reason to `*error`, unless `error` is NULL. Close the result with `sightline_pvs_close`, and free the
/// reason with `sightline_pvs_free`.
///
/// # Safety
/// `path` is a UTF-8 string that ends with NUL. `error` is NULL or points to a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sightline_pvs_open(
    path: *const c_char,
    error: *mut *mut c_char,
) -> *mut SightlinePvs {
    // SAFETY: as the caller promises.
    let path = unsafe { CStr::from_ptr(path) }
        .to_string_lossy()
        .into_owned();
    opened(Pvs::open(path), error)
}

/// Copies `length` bytes, opens the copy as a result, and checks all of it. Returns NULL and a reason like
/// `sightline_pvs_open`.
///
/// # Safety
/// `bytes` points to `length` bytes. `error` is NULL or points to a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sightline_pvs_read(
    bytes: *const u8,
    length: usize,
    error: *mut *mut c_char,
) -> *mut SightlinePvs {
    let bytes = if length == 0 {
        &[][..]
    } else {
        // SAFETY: as the caller promises; a length of 0 needs no bytes.
        unsafe { std::slice::from_raw_parts(bytes, length) }
    };
    opened(Pvs::from_bytes(bytes), error)
}

/// Closes a result. Ignores NULL.
///
/// # Safety
/// `pvs` is an opened result that no thread uses, or NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sightline_pvs_close(pvs: *mut SightlinePvs) {
    if !pvs.is_null() {
        // SAFETY: the pointer came from Box::into_raw, and is closed once.
        drop(unsafe { Box::from_raw(pvs) });
    }
}

/// Frees the reason that a function of this library wrote to `*error`. Ignores NULL.
///
/// # Safety
/// `error` is the result of a function of this library and is freed once, or is NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sightline_pvs_free(error: *mut c_char) {
    if !error.is_null() {
        // SAFETY: the pointer came from CString::into_raw.
        drop(unsafe { CString::from_raw(error) });
    }
}

/// Returns the number of triangles of the scene.
///
/// # Safety
/// `pvs` is an opened result.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sightline_pvs_triangles(pvs: *const SightlinePvs) -> u32 {
    // SAFETY: as the caller promises.
    unsafe { &*pvs }.pvs.triangle_count()
}

/// Returns the number of view cells. Cells are numbered from 0.
///
/// # Safety
/// `pvs` is an opened result.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sightline_pvs_cells(pvs: *const SightlinePvs) -> u32 {
    // SAFETY: as the caller promises.
    unsafe { &*pvs }.pvs.cells()
}

/// Returns the number of objects of the scene. Objects are numbered from 0.
///
/// # Safety
/// `pvs` is an opened result.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sightline_pvs_objects(pvs: *const SightlinePvs) -> u32 {
    // SAFETY: as the caller promises.
    unsafe { &*pvs }.pvs.objects().len() as u32
}

/// Returns the name of an object in UTF-8, or NULL if the object does not exist. Writes the id of the
/// object's first triangle to `*first` and the number of its triangles to `*count`, unless these pointers are
/// NULL. The name is valid until the result is closed.
///
/// # Safety
/// `pvs` is an opened result; `first` and `count` point to a number, or are NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sightline_pvs_object(
    pvs: *const SightlinePvs,
    object: u32,
    first: *mut u32,
    count: *mut u32,
) -> *const c_char {
    // SAFETY: as the caller promises.
    let pvs = unsafe { &*pvs };
    let Some((of, name)) = pvs
        .pvs
        .objects()
        .get(object as usize)
        .zip(pvs.names.get(object as usize))
    else {
        return ptr::null();
    };
    for (place, number) in [(first, of.first), (count, of.count)] {
        if !place.is_null() {
            // SAFETY: as the caller promises.
            unsafe { *place = number };
        }
    }
    name.as_ptr()
}

/// Returns the method of the bake: aggressive, exact, verified or portals. The text is valid until the result
/// is closed.
///
/// # Safety
/// `pvs` is an opened result.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sightline_pvs_method(pvs: *const SightlinePvs) -> *const c_char {
    // SAFETY: as the caller promises.
    unsafe { &*pvs }.method.as_ptr()
}

/// Returns the description of the bake as JSON in UTF-8. The text is valid until the result is closed.
///
/// # Safety
/// `pvs` is an opened result.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sightline_pvs_info(pvs: *const SightlinePvs) -> *const c_char {
    // SAFETY: as the caller promises.
    unsafe { &*pvs }.info.as_ptr()
}

/// Returns the number of the cell that contains a point in world space, or -1 if the point is outside the
/// view box.
///
/// # Safety
/// `pvs` is an opened result.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sightline_pvs_cell_of(
    pvs: *const SightlinePvs,
    x: f32,
    y: f32,
    z: f32,
) -> i64 {
    // SAFETY: as the caller promises.
    unsafe { &*pvs }
        .pvs
        .find_cell([x, y, z])
        .map_or(-1, i64::from)
}

/// Writes the box of a cell, in world space, to `out`: minimum x, y, z, then maximum x, y, z. Returns false
/// if the cell does not exist.
///
/// # Safety
/// `pvs` is an opened result; `out` points to memory for six numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sightline_pvs_cell_box(
    pvs: *const SightlinePvs,
    cell: u32,
    out: *mut f32,
) -> bool {
    // SAFETY: as the caller promises.
    let Some(bounds) = unsafe { &*pvs }.pvs.cell_bounds(cell) else {
        return false;
    };
    for (k, x) in bounds.as_flattened().iter().enumerate() {
        // SAFETY: as the caller promises.
        unsafe { *out.add(k) = *x };
    }
    true
}

/// Returns the flags of a cell, or -1 if the cell does not exist. Bit 0: the cell's tile failed, so the set
/// contains all triangles. Bit 1: the cell contains no viewpoint.
///
/// # Safety
/// `pvs` is an opened result.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sightline_pvs_flags(pvs: *const SightlinePvs, cell: u32) -> i64 {
    // SAFETY: as the caller promises.
    unsafe { &*pvs }.pvs.flags(cell).map_or(-1, i64::from)
}

/// The triangles to draw from a cell.
pub const SIGHTLINE_VISIBLE: u32 = 0;
/// The triangles to draw that were neither seen nor proved hidden.
pub const SIGHTLINE_UNDECIDED: u32 = 1;
/// The objects of the triangles to draw.
pub const SIGHTLINE_VISIBLE_OBJECTS: u32 = 2;
/// The objects of undecided triangles without a triangle that is known to be visible.
pub const SIGHTLINE_UNDECIDED_OBJECTS: u32 = 3;

/// Writes at most `room` ascending ids of a cell's set to `ids`. `set` is one of the constants above. Returns
/// the number of all ids, or -1 if the cell or set does not exist or the set is malformed. With `room` 0 the
/// function only returns the number. The file must not change while it is open.
///
/// # Safety
/// `pvs` is an opened result; `ids` points to memory for `room` numbers, or is NULL and `room` is 0.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sightline_pvs_set(
    pvs: *const SightlinePvs,
    set: u32,
    cell: u32,
    ids: *mut u32,
    room: usize,
) -> i64 {
    // SAFETY: as the caller promises.
    let pvs = &unsafe { &*pvs }.pvs;
    let count = match set {
        _ if room > 0 => None,
        SIGHTLINE_VISIBLE => Some(pvs.visible_count(cell)),
        SIGHTLINE_UNDECIDED => Some(pvs.undecided_count(cell)),
        _ => None,
    };
    // A short file can claim more ids than fit in memory, so count them without a list.
    if let Some(count) = count {
        return count.map_or(-1, i64::from);
    }
    let mut all = Vec::new();
    let read = match set {
        SIGHTLINE_VISIBLE => pvs.visible(cell, &mut all),
        SIGHTLINE_UNDECIDED => pvs.undecided(cell, &mut all),
        SIGHTLINE_VISIBLE_OBJECTS => pvs.visible_objects(cell, &mut all),
        SIGHTLINE_UNDECIDED_OBJECTS => pvs.undecided_objects(cell, &mut all),
        _ => return -1,
    };
    if read.is_err() {
        return -1;
    }
    let some = all.len().min(room);
    if some > 0 {
        // SAFETY: as the caller promises.
        unsafe { ptr::copy_nonoverlapping(all.as_ptr(), ids, some) };
    }
    all.len() as i64
}
