/* A faulty Embree that ignores some triangles: triangles whose number has the remainder 1 after a division by
 * the variable LYING_MODULUS. A worker with this library returns well-formed outputs with wrong sets.
 *
 * REAL is the path of the real library, and MAJOR is its version, 3 or 4, because the two versions have
 * different query functions. This library forwards all other functions. A forwarding function has six
 * arguments of the size of a pointer. With the calling conventions of x86-64 and AArch64, fewer and smaller
 * arguments also arrive unchanged.
 */
#include <dlfcn.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef uintptr_t word;
typedef word (*function)(word, word, word, word, word, word);

#define FORWARDED(X) \
  X(rtcNewDevice) X(rtcReleaseDevice) X(rtcGetDeviceProperty) X(rtcGetDeviceError) X(rtcNewScene) \
  X(rtcReleaseScene) X(rtcSetSceneFlags) X(rtcCommitScene) X(rtcAttachGeometry) X(rtcNewGeometry) \
  X(rtcReleaseGeometry) X(rtcSetNewGeometryBuffer) X(rtcCommitGeometry) X(rtcSetGeometryUserData) \
  X(rtcSetGeometryIntersectFilterFunction)

#define FORWARD(name) \
  static function real_##name; \
  word name(word a, word b, word c, word d, word e, word f) { return real_##name(a, b, c, d, e, f); }
FORWARDED(FORWARD)

static function real_rtcIntersect16, real_rtcIntersect1;
static uint32_t modulus;

static function find(void *library, const char *name) {
  function found = (function)dlsym(library, name);
  if (!found) {
    fprintf(stderr, "lying Embree: %s has no %s\n", REAL, name);
    abort();
  }
  return found;
}

__attribute__((constructor)) static void begin(void) {
  void *library = dlopen(REAL, RTLD_NOW | RTLD_LOCAL);
  const char *text = getenv("LYING_MODULUS");
  if (!library || !text || (modulus = (uint32_t)strtoul(text, NULL, 10)) < 2) {
    fprintf(stderr, "lying Embree: %s, LYING_MODULUS: %s\n", library ? REAL : dlerror(),
            text ? text : "not set");
    abort();
  }
#define FIND(name) real_##name = find(library, #name);
  FORWARDED(FIND)
  FIND(rtcIntersect16)
  FIND(rtcIntersect1)
}

/* Removes the hits of n rays on ignored triangles. A packet of rays consists of rows of n words. Counted from
 * 0, row 8 is tfar, row 17 is the triangle, and row 18 is the geometry. */
static void blind(uint32_t *ray, const float *tfar, size_t n) {
  for (size_t i = 0; i < n; i++) {
    uint32_t *prim = &ray[17 * n + i], *geom = &ray[18 * n + i];
    if (*geom != UINT32_MAX && *prim % modulus == 1) {
      memcpy(&ray[8 * n + i], &tfar[i], sizeof(float));
      *prim = *geom = UINT32_MAX;
    }
  }
}

/* The arguments of the query functions. Embree 3: (valid, scene, context, ray) and (scene, context, ray).
 * Embree 4: (valid, scene, ray, arguments) and (scene, ray, arguments). */
void rtcIntersect16(word a, word b, word c, word d, word e, word f) {
  uint32_t *ray = (uint32_t *)(MAJOR == 3 ? d : c);
  float tfar[16];
  memcpy(tfar, &ray[8 * 16], sizeof tfar);
  real_rtcIntersect16(a, b, c, d, e, f);
  blind(ray, tfar, 16);
}

void rtcIntersect1(word a, word b, word c, word d, word e, word f) {
  uint32_t *ray = (uint32_t *)(MAJOR == 3 ? c : b);
  float tfar;
  memcpy(&tfar, &ray[8], sizeof tfar);
  real_rtcIntersect1(a, b, c, d, e, f);
  blind(ray, &tfar, 1);
}
