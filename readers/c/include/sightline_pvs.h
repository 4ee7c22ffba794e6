// The reader of .pvs results (docs/formats/pvs.md). Made by cbindgen from readers/c/src/lib.rs; do not edit.
//
// Every function may be called from several threads at a time, but for sightline_pvs_close and sightline_pvs_free.

#ifndef SIGHTLINE_PVS_H
#define SIGHTLINE_PVS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

// The triangles to draw from a cell.
#define SIGHTLINE_VISIBLE 0

// Those of them that were neither seen nor proved hidden.
#define SIGHTLINE_UNDECIDED 1

// The objects of the triangles to draw.
#define SIGHTLINE_VISIBLE_OBJECTS 2

// The objects of undecided triangles of which no triangle is known to be visible.
#define SIGHTLINE_UNDECIDED_OBJECTS 3

// An opened result.
typedef struct SightlinePvs SightlinePvs;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Opens a result file and checks all of it. NULL if it is refused; `error`, unless it is NULL, then
// receives the reason, to be freed with `sightline_pvs_free`.
//
// # Safety
// `path` is a string that ends with NUL, in UTF-8. `error` is NULL or a place for a pointer.
struct SightlinePvs *sightline_pvs_open(const char *path, char **error);

// Reads a result from memory, which it copies, and checks all of it.
//
// # Safety
// `bytes` points to `length` bytes. `error` is NULL or a place for a pointer.
struct SightlinePvs *sightline_pvs_read(const uint8_t *bytes, size_t length, char **error);

// Closes a result. NULL is ignored.
//
// # Safety
// `pvs` is an opened result that nobody uses any more, or NULL.
void sightline_pvs_close(struct SightlinePvs *pvs);

// Frees an error. NULL is ignored.
//
// # Safety
// `error` came from a function of this library and is freed once, or is NULL.
void sightline_pvs_free(char *error);

// Number of triangles of the scene.
//
// # Safety
// `pvs` is an opened result.
uint32_t sightline_pvs_triangles(const struct SightlinePvs *pvs);

// Number of view cells.
//
// # Safety
// `pvs` is an opened result.
uint32_t sightline_pvs_cells(const struct SightlinePvs *pvs);

// Number of objects of the scene.
//
// # Safety
// `pvs` is an opened result.
uint32_t sightline_pvs_objects(const struct SightlinePvs *pvs);

// The name of an object in UTF-8, and its first triangle and their number where these are not NULL; NULL
// if there is no such object. The name lives as long as the result.
//
// # Safety
// `pvs` is an opened result; `first` and `count` are places for a number, or NULL.
const char *sightline_pvs_object(const struct SightlinePvs *pvs,
                                 uint32_t object,
                                 uint32_t *first,
                                 uint32_t *count);

// How the sets were made: aggressive, exact, verified or portals. Lives as long as the result.
//
// # Safety
// `pvs` is an opened result.
const char *sightline_pvs_method(const struct SightlinePvs *pvs);

// The description of the bake as JSON in UTF-8. Lives as long as the result.
//
// # Safety
// `pvs` is an opened result.
const char *sightline_pvs_info(const struct SightlinePvs *pvs);

// The cell that holds a point in world space; -1 outside the view box.
//
// # Safety
// `pvs` is an opened result.
int64_t sightline_pvs_cell_of(const struct SightlinePvs *pvs, float x, float y, float z);

// The box of a cell: least x, y, z, then greatest x, y, z. False if there is no such cell.
//
// # Safety
// `pvs` is an opened result; `out` has room for six numbers.
bool sightline_pvs_cell_box(const struct SightlinePvs *pvs, uint32_t cell, float *out);

// The flags of a cell: bit 0, its tile failed, so it draws everything; bit 1, no viewpoint is in it. -1 if
// there is no such cell.
//
// # Safety
// `pvs` is an opened result.
int64_t sightline_pvs_flags(const struct SightlinePvs *pvs,
                            uint32_t cell);

// The ascending ids of a set of a cell, one of the numbers above. Writes at most `room` of them to `ids`,
// and gives the number of all; -1 if there is no such cell or set, or the set is malformed. Ask with
// `room` 0 for the number. The file must not change while it is open.
//
// # Safety
// `pvs` is an opened result; `ids` has room for `room` numbers, or is NULL and `room` is 0.
int64_t sightline_pvs_set(const struct SightlinePvs *pvs,
                          uint32_t set,
                          uint32_t cell,
                          uint32_t *ids,
                          size_t room);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* SIGHTLINE_PVS_H */
