"""What a result says of itself: grid, boxes, statistics, pairs, and copies of it."""

import json
import pickle

import numpy as np
import pytest

import sightline


@pytest.fixture(scope="module")
def pvs(baked):
    return sightline.Pvs(baked)


def test_boxes_and_sets_are_those_of_the_dump(program, pvs):
    lines = [json.loads(line) for line in program("dump rooms.pvs").splitlines()]
    cells = lines[1:]
    assert pvs.grid == (4, 2, 3) and len(pvs) == 24 == len(cells)
    assert np.allclose(pvs.view_box, [lines[0]["view_box"]["min"], lines[0]["view_box"]["max"]])
    assert np.allclose(pvs.boxes, [c["min"] + c["max"] for c in cells])
    assert pvs.set_sizes.tolist() == [len(c["visible"]) for c in cells]
    middles = (pvs.boxes[:, :3] + pvs.boxes[:, 3:]) / 2
    assert pvs.cells_of(middles).tolist() == list(range(24))
    assert pvs.cells_of(np.full((1, 3), 1e9)).tolist() == [-1]
    assert [pvs.cell_of(m) for m in middles] == list(range(24))
    assert pvs.reached.all() and not pvs.set_aside.any() and pvs.granularity == "triangles"
    assert pvs.info == json.loads(pvs.info_json) and pvs.item_count == pvs.triangles


def test_statistics_are_those_of_info(program, pvs):
    expected = program.json("info rooms.pvs --cells")["per_cell"]
    assert len(expected) == 24 and "rays_uniform" in pvs.statistics
    for name, values in pvs.statistics.items():
        assert values.dtype == np.uint64 and values.shape == (24,)
        if name in expected[0]:
            assert values.tolist() == [cell[name] for cell in expected], name


def test_cells_see_the_cells_of_the_dump(program, pvs):
    assert pvs.has_pairs
    for line in program("dump rooms.pvs --items cells").splitlines()[1:]:
        cell = json.loads(line)
        sees = [other for other in range(len(pvs)) if pvs.sees(cell["cell"], other)]
        assert sees == cell["visible"] and 0 < len(sees)
    low, high = pvs.view_box
    assert pvs.sees(tuple(low), tuple(low)) and pvs.sees_box(0, low, high)
    none = sightline.bake((np.eye(3), [[0, 1, 2]]), cells=1, cell_to_cell="off", backend="cpu")
    assert not none.has_pairs
    with pytest.raises(sightline.Error):
        none.sees(0, 0)


def test_a_result_can_be_copied_and_saved(pvs, tmp_path):
    copy = pickle.loads(pickle.dumps(pvs))
    assert copy.to_bytes() == pvs.to_bytes() == sightline.Pvs(pvs.to_bytes()).to_bytes()
    pvs.save(tmp_path / "copy.pvs")
    assert (tmp_path / "copy.pvs").read_bytes() == pvs.to_bytes()


def test_objects_and_contributions(program):
    mesh = program.path("rooms.glb")
    pvs = sightline.bake(mesh, cells=(2, 1, 2), granularity="objects", contributions=True, backend="cpu")
    items, shares = pvs.visible_items(0), pvs.contributions(0)
    assert pvs.granularity == "objects" and pvs.item_count == len(pvs.objects)
    assert shares.shape == (len(items), 2) and (shares >= 0).all() and (shares[:, 0] <= shares[:, 1]).all()
    assert items.tolist() == pvs.visible_objects(0).tolist()


def test_a_file_that_is_no_result_is_refused(program):
    with pytest.raises(sightline.Error):
        sightline.Pvs(program.path("rooms.glb"))
    with pytest.raises(IndexError):
        sightline.Pvs(program.path("rooms.pvs")).visible(24)
