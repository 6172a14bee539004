import json

import numpy as np
import pytest

import srflow


@pytest.fixture
def flow():
    rng = np.random.default_rng(1)
    flow = rng.normal(0, 3, (20, 30, 2)).astype(np.float32)
    flow[3, 4] = np.nan
    return flow


@pytest.mark.parametrize("extension", ["flo", "pfm", "flo5", "npy", "npz"])
def test_files_give_the_flow_back(tmp_path, flow, extension):
    file = tmp_path / f"flow.{extension}"
    srflow.write_flow(file, flow)
    assert np.array_equal(srflow.read_flow(str(file)), flow, equal_nan=True)


def test_files_that_cannot_be_used_are_errors_of_their_kind(tmp_path, flow):
    with pytest.raises(FileNotFoundError, match="nowhere.flo"):
        srflow.read_flow(tmp_path / "nowhere.flo")
    (tmp_path / "broken.flo").write_bytes(b"PIEH\x05\0\0\0\x05\0\0\0")
    with pytest.raises(ValueError, match="broken.flo: file size: expected"):
        srflow.read_flow(tmp_path / "broken.flo")
    with pytest.raises(ValueError, match="extension: expected a flow format"):
        srflow.write_flow(tmp_path / "flow.txt", flow)
    with pytest.raises(ValueError, match="flow: expected a flow, float32 H x W x 2 .* found uint8 20 x 30 x 3"):
        srflow.write_flow(tmp_path / "flow.flo", np.zeros((20, 30, 3), np.uint8))


def test_metrics_are_those_of_the_command(tmp_path, flow, command):
    truth = np.nan_to_num(flow) + np.float32(0.7)
    mask = np.zeros((20, 30), bool)
    mask[5:, 5:] = True
    scores = srflow.metrics(flow, truth, mask)
    assert scores["epe"] == pytest.approx(0.7 * 2**0.5, rel=1e-5)
    assert scores["valid_pixels"] == 15 * 25
    srflow.write_flow(tmp_path / "flow.flo", flow[5:, 5:])
    srflow.write_flow(tmp_path / "truth.flo", truth[5:, 5:])
    ran = command("metrics", tmp_path / "flow.flo", tmp_path / "truth.flo", "--json")
    assert json.loads(ran.stdout) == srflow.metrics(flow[5:, 5:], truth[5:, 5:])
    with pytest.raises(ValueError, match="the prediction is 30x20 and the truth 30x19"):
        srflow.metrics(flow, truth[1:])
    with pytest.raises(ValueError, match="nothing to score: the truth has no known pixel inside the mask"):
        srflow.metrics(flow, truth, np.zeros((20, 30), bool))
    with pytest.raises(ValueError, match="mask: expected a mask, bool H x W"):
        srflow.metrics(flow, truth, mask.astype(np.uint8))


def test_colours_warping_and_consistency(flow):
    colours = srflow.flow_to_rgb(flow)
    assert colours.dtype == np.uint8 and colours.shape == (20, 30, 3) and not colours[3, 4].any()
    assert (srflow.flow_to_rgb(np.zeros((2, 3, 2))) == 255).all()
    with pytest.raises(ValueError, match="max_flow: expected a positive number"):
        srflow.flow_to_rgb(flow, max_flow=0)

    image = np.random.default_rng(2).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    to_the_right = np.zeros((20, 30, 2))
    to_the_right[..., 0] = 4
    warped, valid = srflow.warp(image, to_the_right)
    assert np.array_equal(warped[:, :26], image[:, 4:]) and valid[:, :26].all() and not valid[:, 26:].any()

    assert srflow.consistency(to_the_right, -to_the_right)[:, :26].all()
    assert not srflow.consistency(to_the_right, to_the_right).any()
    assert srflow.consistency(to_the_right, -0.9 * to_the_right, pixels=0.5)[:, :26].all()
    assert not srflow.consistency(to_the_right, -0.9 * to_the_right, pixels=0.3).any()
