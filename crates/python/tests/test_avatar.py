import numpy as np
import pytest

import srflow


@pytest.fixture(scope="module")
def avatar():
    return srflow.Avatar.builtin(7)


def test_poses_are_those_of_the_command(avatar, tmp_path, command):
    units = ["--action-units", "6=0.5,12_L=0.25", "--action-units-next", "12=0.8"]
    arguments = ["--head", "builtin", "--seed", 7, "--size", "64x48", "--out", tmp_path / "out", *units]
    ran = command("rasterize", *arguments)
    assert ran.returncode == 0, ran.stderr
    first, second = avatar.pose({6: 0.5, "12_L": 0.25}), avatar.pose({12: 0.8})
    frame = srflow.rasterize(first, srflow.Camera.facing(first, 64, 48), next=second)
    assert np.array_equal(frame["color"], np.load(tmp_path / "out/color.npy"))
    assert np.array_equal(frame["flow"], srflow.read_flow(tmp_path / "out/flow.flo"))
    assert np.abs(frame["flow"]).max() > 0.3


def test_a_seed_is_a_person(avatar):
    again = srflow.Avatar.read("builtin", seed=7)
    assert np.array_equal(again.pose().means, avatar.pose({}).means)
    assert repr(again).startswith("srflow.Avatar(builtin)  # ")
    assert {1, 12, 43} <= set(avatar.action_units) and avatar.action_units == sorted(avatar.action_units)
    assert avatar.timesteps == 0
    with pytest.raises(IndexError, match="timestep 3 of 0"):
        avatar.at(3)


def test_head_jaw_and_eyes_turn(avatar):
    rest = avatar.pose().means
    moved = avatar.pose(translation=(0.01, 0, -0.02)).means - rest
    assert moved == pytest.approx(np.broadcast_to([0.01, 0, -0.02], rest.shape), abs=1e-6)
    front = rest[:, 2] > np.quantile(rest[:, 2], 0.95)
    left = avatar.pose(neck=[0, 0.3, 0]).means
    assert (left - rest)[front, 0].mean() > 0.01, "to the subject's left"
    down = avatar.pose(rotation=[0.2, 0, 0]).means
    assert (down - rest)[front, 1].mean() < -0.01, "down"
    assert not np.array_equal(avatar.pose(jaw=[0.2, 0, 0]).means, rest)
    both, each = avatar.pose(eyes=[0, 0.3, 0]).means, avatar.pose(eyes=[[0, 0.3, 0], [0, 0, 0]]).means
    still = [(moved != rest).any(axis=1).sum() for moved in (both, each)]
    assert still[0] > still[1] > 0, "one eye alone"


def test_a_trained_avatar_has_the_motion_it_was_recorded_in(tmp_path):
    names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 binding_0".split()
    rows = np.zeros((100, len(names)))
    rows[:, names.index("rot_0")] = 1
    rows[:, -1] = np.arange(100)  # the triangle of each Gaussian
    header = ["ply", "format ascii 1.0", "element vertex 100", *(f"property float {name}" for name in names), "end_header"]
    lines = header + [" ".join(map(str, row)) for row in rows]
    (tmp_path / "point_cloud.ply").write_text("\n".join(lines) + "\n")
    np.savez(tmp_path / "flame_param.npz", translation=np.array([[0, 0, 0], [0.01, 0, 0]], np.float32))
    avatar = srflow.Avatar.read(f"avatar:{tmp_path}@builtin-average")
    assert avatar.timesteps == 2 and len(avatar.pose()) == 100
    moved = avatar.at(1).means - avatar.at(0).means
    assert moved == pytest.approx(np.broadcast_to([0.01, 0, 0], (100, 3)), abs=1e-6)
    with pytest.raises(ValueError, match="the files name no head model"):
        srflow.Avatar.read(tmp_path)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"units": {99: 1}}, "has no action unit 99"),
        ({"units": {"smile": 1}}, 'units: expected numbers of action units, as 12, or "12_L"'),
        ({"units": {12: 1.5}}, "units: expected an intensity from 0 to 1 for unit 12, found 1.5"),
        ({"units": {12: "much"}}, "units: expected an intensity from 0 to 1 for unit 12, found much"),
        ({"neck": [0, 1]}, "neck: expected axis times angle, float32 3, found int64 2"),
        ({"jaw": [np.nan, 0, 0]}, "jaw: expected finite numbers"),
        ({"eyes": np.zeros((3, 2))}, "eyes: expected axis times angle, float32 3 .* or 2 x 3 .* found float64 3 x 2"),
        ({"translation": "far"}, "translation: expected metres, float32 3"),
    ],
)
def test_wrong_poses_are_value_errors(avatar, arguments, message):
    with pytest.raises(ValueError, match=message):
        avatar.pose(**arguments)


def test_heads_that_cannot_be_read_are_errors_of_their_kind(tmp_path):
    with pytest.raises(ValueError, match="head: `nothing`: expected `builtin`, `ict:DIR`"):
        srflow.Avatar.read("nothing")
    with pytest.raises(FileNotFoundError, match="vertex_indices.json"):
        srflow.Avatar.read(f"ict:{tmp_path}")
    with pytest.raises(FileNotFoundError, match="nowhere: opening: .*; give the folder of an avatar"):
        srflow.Avatar.read(f"avatar:{tmp_path / 'nowhere'}")
    with pytest.raises(ValueError, match="point_cloud.ply"):
        srflow.Avatar.read(tmp_path)
