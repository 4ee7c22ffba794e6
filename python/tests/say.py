"""Says of results what their sets are, as JSON, and of damaged ones whether they are refused:
say.py DAMAGED NAME...  reads NAME.pvs, and damaged-0.pvs to damaged-(DAMAGED-1).pvs."""

import json
import sys

import sightline


def said(name):
    pvs = sightline.Pvs(f"{name}.pvs")
    last = len(pvs) - 1
    assert pvs.boxes.shape == (len(pvs), 6)
    corner = tuple(float(x) for x in pvs.boxes[last][3:])
    assert pvs.cell_of(corner) == last and pvs.cell_of((1e9, 0, 0)) is None
    assert (pvs.visible(corner) == pvs.visible(last)).all()
    for wrong in (last + 1, -1, (1e9, 0, 0), "x"):
        try:
            pvs.visible(wrong)
        except (IndexError, ValueError, TypeError, OverflowError):
            continue
        raise AssertionError(wrong)
    return {
        "name": name,
        "triangles": pvs.triangles,
        "method": pvs.method,
        "cells": len(pvs),
        "visible": [pvs.visible(cell).tolist() for cell in range(len(pvs))],
        "undecided": [pvs.undecided(cell).tolist() for cell in range(len(pvs))],
    }


def refused(number):
    with open(f"damaged-{number}.pvs", "rb") as file:
        try:
            sightline.Pvs(file.read())
        except sightline.Error:
            return True
    return False


print(json.dumps({"said": [said(name) for name in sys.argv[2:]], "refused": [refused(k) for k in range(int(sys.argv[1]))]}))
