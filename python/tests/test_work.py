"""Baking, measuring and checking in this process give what the command gives, can be followed and stopped, and
refuse options that are none."""

import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from conftest import sets

import sightline


def test_a_bake_gives_the_bytes_of_the_command_and_tells_how_far_it_is(program, baked, tmp_path):
    told = []
    out = tmp_path / "kept.pvs"
    pvs = sightline.bake(
        program.path("rooms.glb"), cells=(4, 2, 3), backend="cpu", workers=2, output=out, progress=told.append
    )
    with open(baked, "rb") as file:
        expected = file.read()
    assert pvs.to_bytes() == expected and out.read_bytes() == expected
    assert told[-1].done == told[-1].total == 24 and told[-1].what == "cells" and told[-1].state == "done"
    assert told[-1].fraction == 1.0 and str(told[-1]).startswith("24/24 cells, done")
    assert [p.done for p in told] == sorted(p.done for p in told)


def test_measure_says_what_the_command_says(program, baked, tmp_path):
    mesh = program.path("rooms.glb")
    seen = []
    given = {"viewpoints": 40, "seed": 5, "resolution": 64, "pairs": 200, "backend": "cpu"}
    command = "measure rooms.glb rooms.pvs --resolution 64 --backend cpu"
    expected = program.json(f"{command} --viewpoints 40 --seed 5 --pairs 200")
    assert sightline.measure(baked, mesh, progress=seen.append, **given) == expected
    assert seen[-1].done == 40 and seen[-1].what == "frames" and expected["frames"] == 40
    pvs = sightline.Pvs(baked)
    assert sightline.measure(pvs, mesh, **given) == expected
    points = (pvs.boxes[:, :3] + pvs.boxes[:, 3:]) / 2
    np.savetxt(program.path("points.txt"), points)
    expected = program.json(f"{command} --viewpoints-file points.txt")
    assert sightline.measure(pvs, mesh, viewpoints=points, resolution=64, backend="cpu") == expected
    with pytest.raises(sightline.InputError, match="another scene"):
        sightline.measure(pvs, (np.eye(3), [[0, 1, 2]]))


def test_tiles_give_the_bytes_of_a_bake(program, tmp_path):
    mesh, folder = program.path("rooms.glb"), tmp_path / "plan"
    options = {"cells": (4, 2, 3), "block_cells": 8, "backend": "cpu"}
    planned = sightline.plan(mesh, folder, **options)
    assert planned["tiles"] == 4 and planned["profile"].startswith("cpu/")
    told = []
    for number in (3, 2, 0, 1):
        tile = sightline.tile(folder, number, progress=told.append)
        assert tile["tile"] == number and tile["computed"]
    assert not sightline.tile(folder, 1)["computed"] and told[-1].what == "cells"
    pvs = sightline.assemble(folder, tmp_path / "out.pvs")
    assert pvs.to_bytes() == sightline.bake(mesh, **options).to_bytes()
    with pytest.raises(sightline.OptionError, match="no tile 4"):
        sightline.tile(folder, 4)
    with pytest.raises(TypeError, match="plan has no option time_budget"):
        sightline.plan(mesh, folder, time_budget=3, **options)


def test_verify_says_what_the_command_says(program, baked):
    program("generate slits --triangles 140 -o slits.glb")
    mesh = program.path("slits.glb")
    pvs = sightline.bake(mesh, cells=(2, 1, 2), method="exact", certificates=True, backend="cpu")
    pvs.save(program.path("slits.pvs"))
    told = sightline.verify(pvs, mesh)
    assert told == program.json("verify slits.glb slits.pvs")
    assert told["accepted"] and told["witnesses_checked"] > 0 and told["certificates_checked"] > 0
    assert sightline.verify(pvs, mesh, sample=5)["sampled"]
    with pytest.raises(sightline.InputError, match="has no certificates"):
        sightline.verify(baked, program.path("rooms.glb"))


def test_a_claim_that_does_not_hold_is_refused(monkeypatch):
    # How the checker finds one is tested beside it; here only what becomes of its answer.
    refusal = '{"accepted":false,"cell":3,"reason":"the witness of triangle 5 is obstructed"}'
    monkeypatch.setattr(sightline._work._sightline, "verify", lambda *_: refusal)
    with pytest.raises(sightline.Refused, match="cell 3: the witness of triangle 5") as refused:
        sightline.verify(sightline.bake((np.eye(3), [[0, 1, 2]]), cells=1, backend="cpu"), (np.eye(3), [[0, 1, 2]]))
    assert refused.value.cell == 3


def test_other_threads_run_during_a_bake(program):
    counted = 0
    ended = threading.Event()

    def count():
        nonlocal counted
        while not ended.wait(0.001):
            counted += 1

    # A bake that fails must not leave a thread for which the interpreter waits.
    thread = threading.Thread(target=count, daemon=True)
    thread.start()
    began = time.monotonic()
    sightline.bake(program.path("rooms.glb"), cells=(4, 2, 3), backend="cpu")
    took = time.monotonic() - began
    ended.set()
    thread.join()
    assert counted > 20 * took, f"{counted} turns in {took} s"


class Enough(Exception):
    pass


def test_what_progress_raises_ends_a_bake_and_the_same_bake_goes_on(program, tmp_path, caplog):
    caplog.set_level("INFO", logger="sightline")
    mesh, job = program.path("rooms.glb"), {"cells": (8, 2, 8), "target_error": 1e-4, "backend": "cpu"}
    job.update({"block_cells": 8, "workers": 1, "data_dir": tmp_path})

    def stop(progress):
        if progress.done > 0:
            raise Enough

    with pytest.raises(Enough):
        sightline.bake(mesh, progress=stop, **job)
    done = sightline.bake(mesh, **job)
    assert "continuing: " in caplog.text
    caplog.clear()
    assert sets(sightline.bake(mesh, **job)) == sets(done)
    assert "in the store already" in caplog.text


def test_ctrl_c_ends_a_bake(program):
    code = (
        "import signal, sightline\n"
        # Whoever started the tests may ignore it.
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "def told(p): print(p, flush=True)\n"
        f"sightline.bake({program.path('rooms.glb')!r}, cells=(16, 8, 16), max_error=1e-5, progress=told)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout.readline()
    process.send_signal(signal.SIGINT)
    began = time.monotonic()
    _, err = process.communicate(timeout=60)
    assert err.rstrip().endswith("KeyboardInterrupt") and time.monotonic() - began < 30, err


@pytest.mark.parametrize(
    "options, error, says",
    [
        ({"cell": 4}, TypeError, "bake has no option cell; did you mean cells"),
        ({"cells": (4, 4)}, sightline.OptionError, r"cells: \(4, 4\) is not one number or three"),
        ({"cells": 2.5}, TypeError, "cells"),
        ({"cells": 0}, sightline.OptionError, "cells"),
        ({"cells": "walls"}, sightline.OptionError, "walls:N"),
        ({"method": "guess"}, sightline.OptionError, "aggressive, exact"),
        ({"method": 3}, TypeError, "method: 3 is not a text"),
        ({"certificates": True}, sightline.OptionError, "certificates needs method exact or verified"),
        ({"certificates": "yes"}, TypeError, "True or False"),
        ({"target_error": 2}, sightline.OptionError, "target"),
        ({"view_box": (0, 0, 0, 1, 1)}, sightline.OptionError, "view_box: give 6 numbers"),
        ({"workers": 0}, sightline.OptionError, "workers"),
        ({"progress": 7}, TypeError, "progress must be a function"),
        ({"seed": "x"}, TypeError, "seed: 'x' is not a whole number"),
        ({"viewpoints": [[0, 0]]}, sightline.OptionError, "viewpoints"),
        ({"data_dir": os.devnull}, sightline.SightlineError, "data_dir"),
    ],
)
def test_options_that_are_none_are_refused_in_a_sentence(program, options, error, says):
    with pytest.raises(error, match=says) as refused:
        sightline.bake(program.path("rooms.glb"), **options)
    assert "--" not in str(refused.value) and "\n" not in str(refused.value)
    if error is sightline.OptionError and "workers" not in options:
        assert refused.value.option in options
