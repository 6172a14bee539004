import json
import pickle

import numpy as np
import pytest

import srflow

SH_0 = 0.28209479177387814


def one(position=(0, 0, 2), opacity=0.8, color=(1.0, 0.5, 0.0)):
    """A round Gaussian, several pixels wide in `camera`."""
    sh = ((np.array(color) - 0.5) / SH_0).reshape(1, 1, 3)
    return srflow.Gaussians([position], [[0.1, 0.1, 0.1]], [[0, 0, 0, 1]], [opacity], sh)


@pytest.fixture
def camera():
    return srflow.Camera(33, 25, 32)


def some(count=12, degree=1, seed=3):
    """Gaussians in front of `camera`, and the same ones moved."""
    rng = np.random.default_rng(seed)
    means = rng.uniform([-0.5, -0.4, 1.8], [0.5, 0.4, 2.6], (count, 3))
    rest = [
        rng.uniform(0.05, 0.15, (count, 3)),
        rng.normal(size=(count, 4)),
        rng.uniform(0.3, 0.9, count),
        rng.normal(0, 0.3, (count, (degree + 1) ** 2, 3)),
    ]
    return [means, *rest], [means + rng.normal(0, 0.05, means.shape), *rest]


def test_a_gaussian_has_its_colour_depth_and_flow(camera):
    frame = srflow.rasterize(one(), camera, next=one((0.1, -0.05, 2)), background=(0, 0, 1))
    assert {name: (value.dtype.name, value.shape) for name, value in frame.items()} == {
        "color": ("float32", (25, 33, 3)),
        "image": ("uint8", (25, 33, 3)),
        "alpha": ("float32", (25, 33)),
        "mask": ("bool", (25, 33)),
        "depth": ("float32", (25, 33)),
        "flow": ("float32", (25, 33, 2)),
        "flow_normalized": ("float32", (25, 33, 2)),
        "depth_next": ("float32", (25, 33)),
    }
    at = 12, 16  # the centre of the picture
    assert frame["alpha"][at] == pytest.approx(0.8, abs=1e-6) and frame["mask"][at]
    assert frame["color"][at] == pytest.approx([0.8, 0.4, 0.2], abs=1e-6)
    assert list(frame["image"][at]) == [204, 102, 51]
    assert frame["depth"][at] == pytest.approx(2) == frame["depth_next"][at]
    motion = np.array([0.1, -0.05]) * 32 / 2
    assert frame["flow_normalized"][at] == pytest.approx(motion, abs=1e-5)
    assert frame["flow"][at] == pytest.approx(0.8 * motion, abs=1e-5)
    corner = {name: frame[name][0, 0] for name in ["color", "alpha", "depth", "flow"]}
    assert list(corner["color"]) == [0, 0, 1] and not corner["alpha"] and not corner["depth"] and not corner["flow"].any()


def test_there_is_flow_where_something_moves(camera):
    assert "flow" not in srflow.rasterize(one(), camera)
    moved = np.eye(4)
    moved[0, 3] = 0.25
    other = srflow.Camera(33, 25, 32, camera_from_world=moved)
    flow = srflow.rasterize(one(), camera, camera_next=other)["flow_normalized"]
    assert flow[12, 16] == pytest.approx([4, 0], abs=1e-5)
    paper = srflow.rasterize(one(), camera, camera_next=other, pixel_convention="paper")["flow_normalized"]
    assert paper[12, 16] == pytest.approx([4 * 32 / 33, 0], abs=1e-5)


def test_results_are_those_of_the_command(tmp_path, command):
    first, second = some()
    for name, arrays in [("first.ply", first), ("second.ply", second)]:
        srflow.Gaussians(*arrays, antialiased=True).write(tmp_path / name)
    out = tmp_path / "out"
    options = ["--size", "48x40", "--background", "#ff8000", "--sort-per-pixel"]
    ran = command("rasterize", tmp_path / "first.ply", "--next", tmp_path / "second.ply", "--out", out, *options)
    assert ran.returncode == 0, ran.stderr
    first, second = (srflow.Gaussians.read(tmp_path / name) for name in ["first.ply", "second.ply"])
    assert first.antialiased
    camera = srflow.Camera.facing(first, 48, 40)
    frame = srflow.rasterize(first, camera, second, background="#ff8000", sort_per_pixel=True)
    for name in ["color", "alpha", "depth"]:
        assert np.array_equal(frame[name], np.load(out / f"{name}.npy")), name
    for name in ["flow", "flow_normalized"]:
        assert np.array_equal(frame[name], srflow.read_flow(out / f"{name}.flo")), name
    for option in [{"sort_per_pixel": False}, {"antialiased": False}, {"background": "black"}]:
        other = srflow.rasterize(first, camera, **{"background": "#ff8000", "sort_per_pixel": True} | option)
        assert not np.array_equal(other["color"], frame["color"]), option


def test_gradients_are_those_of_finite_differences(camera):
    first, second = some(count=4)
    next_camera = srflow.Camera(33, 25, 33, camera_from_world=np.eye(4))
    rng = np.random.default_rng(1)
    shapes = {"color": (25, 33, 3), "alpha": (25, 33), "depth": (25, 33), "flow": (25, 33, 2), "depth_next": (25, 33)}
    # Where little is visible, the depth of the Gaussians jumps as the faint edge of one passes.
    solid = srflow.rasterize(srflow.Gaussians(*first), camera)["alpha"] > 0.3
    weights = {name: (rng.normal(size=shape).T * solid.T).T for name, shape in shapes.items()}

    def loss(arrays, means_next):
        pair = srflow.Gaussians(*arrays), camera, srflow.Gaussians(means_next, *arrays[1:])
        frame = srflow.rasterize(*pair, camera_next=next_camera, background="white")
        return sum(float((frame[name].astype(float) * weight).sum()) for name, weight in weights.items())

    pair = srflow.Gaussians(*first), camera, srflow.Gaussians(second[0], *first[1:])
    found = srflow.rasterize_backward(weights, *pair, camera_next=next_camera, background="white")
    arrays = dict(zip(["means", "scales", "rotations", "opacities", "sh"], first, strict=True)) | {"means_next": second[0]}
    for name, values in arrays.items():
        assert found[name].shape == values.shape and found[name].dtype == np.float32, name
        for _ in range(4):
            direction = rng.normal(size=values.shape)
            ends = []
            for step in (2e-3, -2e-3):
                changed = arrays | {name: values + step * direction}
                ends.append(loss([changed[key] for key in list(arrays)[:5]], changed["means_next"]))
            expected = (ends[0] - ends[1]) / 4e-3
            size = np.abs(found[name] * direction).sum()
            assert (found[name] * direction).sum() == pytest.approx(expected, abs=0.03 * size), name
    assert found["visible"].all() and found["centers"].shape == found["centers_absolute"].shape == (4, 2)
    for name in ["camera", "camera_next"]:
        gradient = found[name]
        assert gradient["translation"].shape == gradient["rotation"].shape == (3,) and gradient["fx"] != 0
    # The principal point moves the picture of all Gaussians alike.
    only_color = srflow.rasterize_backward({"color": weights["color"]}, *pair[:2], background="white")
    assert "means_next" not in only_color and "camera_next" not in only_color
    ends = [
        float((srflow.rasterize(pair[0], srflow.Camera(33, 25, 32, cx=16 + step), background="white")["color"] * weights["color"]).sum())
        for step in (0.01, -0.01)
    ]
    assert only_color["camera"]["cx"] == pytest.approx((ends[0] - ends[1]) / 0.02, rel=0.05)


def test_arrays_go_in_and_out(tmp_path):
    (means, scales, rotations, opacities, sh), _ = some()
    gaussians = srflow.Gaussians(np.asfortranarray(means), scales[::-1][::-1], rotations, opacities, sh)
    assert len(gaussians) == 12 and repr(gaussians) == "srflow.Gaussians(12, sh_degree=1)"
    for name, expected in [("means", means), ("scales", scales), ("rotations", rotations), ("opacities", opacities), ("sh", sh)]:
        found = getattr(gaussians, name)
        assert found.dtype == np.float32 and np.array_equal(found, expected.astype(np.float32)), name
    again = pickle.loads(pickle.dumps(gaussians))
    assert np.array_equal(again.sh, gaussians.sh) and np.array_equal(again.rotations, gaussians.rotations)
    gaussians.write(tmp_path / "a.ply")
    read = srflow.Gaussians.read(str(tmp_path / "a.ply"))
    assert np.array_equal(read.means, gaussians.means) and read.scales == pytest.approx(gaussians.scales, rel=1e-6)
    unit = gaussians.rotations / np.linalg.norm(gaussians.rotations, axis=1, keepdims=True)
    assert read.rotations == pytest.approx(unit, abs=1e-6)
    empty = srflow.Gaussians(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 4)), np.zeros(0), np.zeros((0, 1, 3)))
    assert not srflow.rasterize(empty, srflow.Camera(4, 3, 2))["alpha"].any()


@pytest.mark.parametrize(
    "change, message",
    [
        ({"means": np.zeros((5, 2))}, "means: expected centres, float32 N x 3, found float64 5 x 2"),
        ({"scales": np.ones((4, 3), bool)}, "scales: expected lengths, float32 12 x 3, found bool 4 x 3"),
        ({"rotations": np.ones((12, 3))}, "rotations: expected quaternions x, y, z, w, float32 12 x 4, found float64 12 x 3"),
        ({"opacities": np.ones((12, 1))}, "opacities: expected numbers from 0 to 1, float32 12, found float64 12 x 1"),
        ({"sh": np.ones((12, 3))}, "sh: expected spherical harmonics, float32 12 x K x 3 with K = 1, 4, 9 or 16, found float64 12 x 3"),
        ({"sh": np.ones((12, 5, 3))}, "sh: expected spherical harmonics, .* found float64 12 x 5 x 3"),
    ],
)
def test_wrong_arrays_are_value_errors_that_say_what_was_expected(change, message):
    arrays = dict(zip(["means", "scales", "rotations", "opacities", "sh"], some()[0], strict=True))
    with pytest.raises(ValueError, match=message):
        srflow.Gaussians(**arrays | change)


def test_wrong_scenes_are_errors(tmp_path, camera):
    with pytest.raises(ValueError, match="must correspond Gaussian by Gaussian: the first has 1, the next 12"):
        srflow.rasterize(one(), camera, srflow.Gaussians(*some()[0]))
    with pytest.raises(ValueError, match="images differ in size: 33x25 and 32x25"):
        srflow.rasterize(one(), camera, camera_next=srflow.Camera(32, 25, 32))
    with pytest.raises(ValueError, match="background: expected a colour, float32 3 .* found int64 2"):
        srflow.rasterize(one(), camera, background=(1, 2))
    with pytest.raises(ValueError, match="background: .*mauve"):
        srflow.rasterize(one(), camera, background="mauve")
    with pytest.raises(ValueError, match='pixel_convention: expected "splat" or "paper", found "ndc"'):
        srflow.rasterize(one(), camera, pixel_convention="ndc")
    with pytest.raises(TypeError, match="Gaussians"):
        srflow.rasterize({"means": 1}, camera)
    with pytest.raises(ValueError, match=r'gradients\["color"\]: expected float32 25 x 33 x 3, found float64 33 x 25 x 3'):
        srflow.rasterize_backward({"color": np.zeros((33, 25, 3))}, one(), camera)
    with pytest.raises(ValueError, match='gradients: expected some of color, alpha, depth, flow, depth_next; found "image"'):
        srflow.rasterize_backward({"image": np.zeros((25, 33, 3))}, one(), camera)
    with pytest.raises(ValueError, match="flow and depth_next need the next frame"):
        srflow.rasterize_backward({"flow": np.zeros((25, 33, 2))}, one(), camera)
    with pytest.raises(FileNotFoundError, match="nowhere.ply"):
        srflow.Gaussians.read(tmp_path / "nowhere.ply")
    with pytest.raises(ValueError, match="opacity: expected 0 to 1, found 2.0 of Gaussian 0"):
        one(opacity=2).write(tmp_path / "a.ply")


def test_cameras_have_opencvs_axes(tmp_path):
    camera = srflow.Camera(40, 30, 50, camera_from_world=[[0, 0, -1, 0.5], [0, 1, 0, 0], [1, 0, 0, 2], [0, 0, 0, 1]])
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (50, 50, 19.5, 14.5)
    assert camera.camera_from_world.dtype == np.float64
    assert camera.position == pytest.approx(-camera.camera_from_world[:3, :3].T @ camera.camera_from_world[:3, 3])
    again = pickle.loads(pickle.dumps(camera))
    assert np.array_equal(again.camera_from_world, camera.camera_from_world) and repr(again) == repr(camera)
    assert (camera.resized(80, 60).fx, camera.resized(80, 60).cx) == (100, 39.5)

    record = {name: getattr(camera, name) for name in ["width", "height", "fx", "fy", "cx", "cy"]}
    (tmp_path / "cam.json").write_text(json.dumps(record | {"w2c": camera.camera_from_world.tolist()}))
    (read,) = srflow.Camera.read(tmp_path / "cam.json")
    assert (read.name, read.distortion) == ("cam", None)
    assert np.array_equal(read.camera_from_world, camera.camera_from_world)

    facing = srflow.Camera.facing(one((1, 2, 3)), 20, 10)
    assert (facing.width, facing.height) == (20, 10)
    assert facing.position[:2] == pytest.approx([1, 2]) and facing.position[2] > 3.2
    around = facing.orbit([1, 2, 3], 360, 4)
    assert around[0].position == pytest.approx(facing.position) and len(around) == 4
    assert around[2].position == pytest.approx([1, 2, 6 - facing.position[2]])


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"width": 0}, "camera: the image is 0x3"),
        ({"fx": -1}, "camera: fx is -1: a focal length must be positive"),
        ({"cx": float("nan")}, "camera: the principal point is"),
        ({"camera_from_world": np.eye(3)}, "camera_from_world: expected a rotation and a translation, float64 4 x 4, found float64 3 x 3"),
        ({"camera_from_world": 2 * np.eye(4)}, "camera: camera from world is not a rigid motion"),
    ],
)
def test_cameras_that_cannot_be_rendered_are_value_errors(arguments, message):
    with pytest.raises(ValueError, match=message):
        srflow.Camera(**{"width": 4, "height": 3, "fx": 5} | arguments)


def test_camera_files_that_cannot_be_used_are_errors_of_their_kind(tmp_path):
    with pytest.raises(FileNotFoundError, match="none.json"):
        srflow.Camera.read(tmp_path / "none.json")
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(ValueError, match="format: expected a camera with width"):
        srflow.Camera.read(tmp_path / "other.json")
    with pytest.raises(ValueError, match="gaussians: expected at least one Gaussian"):
        srflow.Camera.facing(srflow.Gaussians(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 4)), [], np.zeros((0, 1, 3))))
