/* Prints the sets of results as JSON, and for damaged results whether the reader rejects them:
   say DAMAGED NAME...  reads NAME.pvs, and damaged-0.pvs to damaged-(DAMAGED-1).pvs. */

#include <stdio.h>
#include <stdlib.h>

#include "sightline_pvs.h"

static void sets(const SightlinePvs *pvs, uint32_t set)
{
    printf("[");
    for (uint32_t cell = 0; cell < sightline_pvs_cells(pvs); cell++) {
        int64_t count = sightline_pvs_set(pvs, set, cell, NULL, 0);
        uint32_t *ids = malloc(((size_t)count + 1) * sizeof *ids);
        if (count < 0 || ids == NULL || sightline_pvs_set(pvs, set, cell, ids, (size_t)count) != count) {
            exit(1);
        }
        printf(cell ? ",[" : "[");
        for (int64_t k = 0; k < count; k++) {
            printf(k ? ",%u" : "%u", ids[k]);
        }
        printf("]");
        free(ids);
    }
    printf("]");
}

int main(int argc, char **argv)
{
    char path[256];
    char *error = NULL;
    printf("{\"said\":[");
    for (int k = 2; k < argc; k++) {
        snprintf(path, sizeof path, "%s.pvs", argv[k]);
        SightlinePvs *pvs = sightline_pvs_open(path, &error);
        if (pvs == NULL) {
            fprintf(stderr, "%s: %s\n", path, error);
            return 1;
        }
        float box[6];
        uint32_t last = sightline_pvs_cells(pvs) - 1;
        if (!sightline_pvs_cell_box(pvs, last, box) || sightline_pvs_cell_box(pvs, last + 1, box)
            || sightline_pvs_cell_of(pvs, box[3], box[4], box[5]) != (int64_t)last
            || sightline_pvs_set(pvs, SIGHTLINE_VISIBLE, last + 1, NULL, 0) != -1) {
            fprintf(stderr, "%s: the last cell\n", path);
            return 1;
        }
        printf("%s{\"name\":\"%s\",\"triangles\":%u,\"method\":\"%s\",\"cells\":%u,\"visible\":", k > 2 ? "," : "",
               argv[k], sightline_pvs_triangles(pvs), sightline_pvs_method(pvs), sightline_pvs_cells(pvs));
        sets(pvs, SIGHTLINE_VISIBLE);
        printf(",\"undecided\":");
        sets(pvs, SIGHTLINE_UNDECIDED);
        printf("}");
        sightline_pvs_close(pvs);
    }
    printf("],\"refused\":[");
    for (int k = 0; k < atoi(argv[1]); k++) {
        snprintf(path, sizeof path, "damaged-%d.pvs", k);
        SightlinePvs *pvs = sightline_pvs_open(path, &error);
        printf("%s%s", k ? "," : "", pvs == NULL && error != NULL ? "true" : "false");
        sightline_pvs_close(pvs);
        sightline_pvs_free(error);
        error = NULL;
    }
    printf("]}\n");
    return 0;
}
