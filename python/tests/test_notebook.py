"""The notebook runs from start to end, and its last cell draws a picture."""

import base64
import io
import pathlib

import matplotlib.image
import nbclient
import nbformat
import numpy as np

NOTEBOOK = pathlib.Path(__file__).parent.parent / "examples" / "town.ipynb"


def test_the_notebook_ends_in_a_plot(tmp_path):
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    assert all(cell.get("outputs", []) == [] for cell in notebook.cells), "it is kept without outputs"
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    pictures = [o.data["image/png"] for o in notebook.cells[-1].outputs if "image/png" in o.get("data", {})]
    assert len(pictures) == 1
    picture = matplotlib.image.imread(io.BytesIO(base64.b64decode(pictures[0])))
    colours = {tuple(c) for c in np.round(picture.reshape(-1, picture.shape[-1]) * 15).astype(int).tolist()}
    assert min(picture.shape[:2]) > 300 and len(colours) > 40, f"{picture.shape}, {len(colours)} colours"
