import os
import pathlib

import pytest

NOTEBOOKS = sorted((pathlib.Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run_from_top_to_bottom(path, tmp_path, monkeypatch):
    nbclient, nbformat = (
        pytest.importorskip(name, reason="notebooks: nbclient is not installed") for name in ("nbclient", "nbformat")
    )
    for package in ["ipykernel", *(name for name in ("torch", "matplotlib") if f"import {name}" in path.read_text())]:
        pytest.importorskip(package, reason=f"{'pytorch' if package == 'torch' else package}: not installed")
    monkeypatch.setitem(os.environ, "MPLBACKEND", "agg")
    notebook = nbformat.read(path, as_version=4)
    client = nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": tmp_path}})
    client.execute()
    assert not any(cell.get("outputs") for cell in nbformat.read(path, as_version=4).cells), "notebooks are kept without outputs"
