import importlib.util
import pathlib

import pytest

EXAMPLES = pathlib.Path(__file__).parents[1] / "examples"


def example(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_pytorch_fits_gaussians_by_the_rasterizer():
    pytest.importorskip("torch", reason="pytorch: not installed")
    losses = example("torch_rasterizer").main(steps=40, count=500, side=48)
    assert losses[-1] < losses[0] / 3


def test_tqdm_shows_progress(tmp_path, capsys):
    pytest.importorskip("tqdm", reason="tqdm: not installed")
    result = example("progress").main(tmp_path, scenes=1, frames=8, steps=2)
    assert result["steps"] == 2
    shown = capsys.readouterr().err
    assert "rendering: 100%" in shown and "8/8" in shown and "training: 100%" in shown and "epe=" in shown
    assert example("progress").main(tmp_path, scenes=1, frames=8, steps=2)["steps"] == 2, "run again"
