//! The reader of `.pvs` results for C, and for languages that call C.
//!
//! Every function may be called from several threads at a time, but for `sightline_pvs_close` and
//! `sightline_pvs_free`. Nothing here panics: what a file cannot give comes back as an error.

#![allow(
    unsafe_code,
    reason = "C passes pointers; each function says what they must be"
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

/// Text for C. A NUL within it would end it early, and is left out.
fn text(of: &str) -> CString {
    CString::new(of.replace('\0', "")).unwrap_or_default()
}

/// Hands out an opened result, or writes why there is none.
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
                // SAFETY: the caller gives a place for a pointer, or NULL.
                unsafe { *error = text(&e.to_string()).into_raw() };
            }
            ptr::null_mut()
        }
    }
}

/// Opens a result file and checks all of it. NULL if it is refused; `error`, unless it is NULL, then
/// receives the reason, to be freed with `sightline_pvs_free`.
///
/// # Safety
/// `path` is a string that ends with NUL, in UTF-8. `error` is NULL or a place for a pointer.
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

/// Reads a result from memory, which it copies, and checks all of it.
///
/// # Safety
/// `bytes` points to `length` bytes. `error` is NULL or a place for a pointer.
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

/// Closes a result. NULL is ignored.
///
/// # Safety
/// `pvs` is an opened result that nobody uses any more, or NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sightline_pvs_close(pvs: *mut SightlinePvs) {
    if !pvs.is_null() {
        // SAFETY: it came from Box::into_raw, and is closed once.
        drop(unsafe { Box::from_raw(pvs) });
    }
}

/// Frees an error. NULL is ignored.
///
/// # Safety
/// `error` came from a function of this library and is freed once, or is NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sightline_pvs_free(error: *mut c_char) {
    if !error.is_null() {
        // SAFETY: it came from CString::into_raw.
        drop(unsafe { CString::from_raw(error) });
    }
}

/// Number of triangles of the scene.
///
/// # Safety
/// `pvs` is an opened result.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sightline_pvs_triangles(pvs: *const SightlinePvs) -> u32 {
    // SAFETY: as the caller promises.
    unsafe { &*pvs }.pvs.triangle_count()
}

/// Number of view cells.
///
/// # Safety
/// `pvs` is an opened result.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sightline_pvs_cells(pvs: *const SightlinePvs) -> u32 {
    // SAFETY: as the caller promises.
    unsafe { &*pvs }.pvs.cells()
}

/// Number of objects of the scene.
///
/// # Safety
/// `pvs` is an opened result.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sightline_pvs_objects(pvs: *const SightlinePvs) -> u32 {
    // SAFETY: as the caller promises.
    unsafe { &*pvs }.pvs.objects().len() as u32
}

/// The name of an object in UTF-8, and its first triangle and their number where these are not NULL; NULL
/// if there is no such object. The name lives as long as the result.
///
/// # Safety
/// `pvs` is an opened result; `first` and `count` are places for a number, or NULL.
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

/// How the sets were made: aggressive, exact, verified or portals. Lives as long as the result.
///
/// # Safety
/// `pvs` is an opened result.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sightline_pvs_method(pvs: *const SightlinePvs) -> *const c_char {
    // SAFETY: as the caller promises.
    unsafe { &*pvs }.method.as_ptr()
}

/// The description of the bake as JSON in UTF-8. Lives as long as the result.
///
/// # Safety
/// `pvs` is an opened result.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sightline_pvs_info(pvs: *const SightlinePvs) -> *const c_char {
    // SAFETY: as the caller promises.
    unsafe { &*pvs }.info.as_ptr()
}

/// The cell that holds a point in world space; -1 outside the view box.
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

/// The box of a cell: least x, y, z, then greatest x, y, z. False if there is no such cell.
///
/// # Safety
/// `pvs` is an opened result; `out` has room for six numbers.
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

/// The flags of a cell: bit 0, its tile failed, so it draws everything; bit 1, no viewpoint is in it. -1 if
/// there is no such cell.
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
/// Those of them that were neither seen nor proved hidden.
pub const SIGHTLINE_UNDECIDED: u32 = 1;
/// The objects of the triangles to draw.
pub const SIGHTLINE_VISIBLE_OBJECTS: u32 = 2;
/// The objects of undecided triangles of which no triangle is known to be visible.
pub const SIGHTLINE_UNDECIDED_OBJECTS: u32 = 3;

/// The ascending ids of a set of a cell, one of the numbers above. Writes at most `room` of them to `ids`,
/// and gives the number of all; -1 if there is no such cell or set, or the set is malformed. Ask with
/// `room` 0 for the number. The file must not change while it is open.
///
/// # Safety
/// `pvs` is an opened result; `ids` has room for `room` numbers, or is NULL and `room` is 0.
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
    // A short file can claim more ids than fit in memory. Counting them needs no list.
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
