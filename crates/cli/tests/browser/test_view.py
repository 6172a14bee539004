import base64
import json
import urllib.error
import urllib.request

import numpy as np
import pytest
from conftest import settle, show, srflow, wait_until

SIZE = 320


def sums(tab, picture):
    """What the page has summed up: colour and alpha (0), or flow, depth and alpha (1), H x W x 4."""
    text = tab.evaluate(
        f"""(() => {{
            const sums = new Uint8Array(page.splats.sums({picture}, 0, 0, {SIZE}, {SIZE}).buffer);
            let text = "";
            for (let i = 0; i < sums.length; i += 4096) text += String.fromCharCode(...sums.subarray(i, i + 4096));
            return btoa(text);
        }})()"""
    )
    return np.frombuffer(base64.b64decode(text), np.float32).reshape(SIZE, SIZE, 4)


def resize(tab):
    tab.evaluate(f"page.fixed = [{SIZE}, {SIZE}]; page.changed()")
    settle(tab)


def camera_of(tab, folder):
    """The page's camera as an option of `srflow rasterize`, whose own frames the pose, not the head at rest."""
    camera = tab.evaluate(f"page.camera.at({SIZE}, {SIZE})")
    (cx, cy), focal = camera["centre"], camera["focal"]
    facts = {"width": SIZE, "height": SIZE, "fx": focal, "fy": focal, "cx": cx, "cy": cy, "w2c": [*camera["rows"], [0, 0, 0, 1]]}
    (folder / "camera.json").write_text(json.dumps(facts))
    return ["--camera", folder / "camera.json"]


def read_flo(path):
    width, height = np.fromfile(path, np.int32, 2, offset=4)
    return np.fromfile(path, np.float32, offset=12).reshape(height, width, 2)


def hold_to_rasterizer(tab, folder, moved):
    """Mean differences: colour under a tenth of a level of 255, flow under 0.005 px, alpha under 0.001."""
    seen, motion = sums(tab, 0), sums(tab, 1)
    color, alpha = np.load(folder / "color.npy"), np.load(folder / "alpha.npy")
    assert alpha.mean() > 0.1, "the picture shows something"
    assert np.abs(seen[..., :3] - color).mean() < 0.1 / 255
    assert np.abs(seen[..., 3] - alpha).mean() < 0.001
    flow = read_flo(folder / "flow.flo")
    assert (np.abs(flow).max() > 0.5) == moved
    assert np.abs(motion[..., :2] - flow).mean() < 0.005
    visible = alpha > 0.5
    depth = np.load(folder / "depth.npy")
    assert np.abs(motion[..., 2] / np.maximum(motion[..., 3], 1e-6) - depth)[visible].mean() < 0.001


@pytest.mark.parametrize("ending", ["ply", "spz"])
def test_a_file_of_gaussians_is_drawn_as_the_rasterizer_does(tab, tmp_path, ending):
    file = tmp_path / f"head.{ending}"
    srflow("avatar", "export", "--head", "builtin", "--seed", 3, "--output", file)
    srflow("view", file, "-o", tmp_path / "view.html")
    srflow("rasterize", file, "--size", f"{SIZE}x{SIZE}", "--out", tmp_path / "truth")
    show(tab, tmp_path / "view.html")
    resize(tab)
    hold_to_rasterizer(tab, tmp_path / "truth", moved=False)


def test_a_slider_moves_an_avatar_and_its_flow_is_exact(tab, tmp_path):
    srflow("view", "builtin", "--seed", 7, "-o", tmp_path / "view.html")
    show(tab, tmp_path / "view.html")
    resize(tab)
    units = ["--action-units", "4=0.5,12_L=0.8,12_R=0.8,26=0.6", "--action-units-next", "12=0"]
    srflow("rasterize", "--head", "builtin", "--seed", 7, *units, *camera_of(tab, tmp_path), "--out", tmp_path / "truth")
    smile = [("lip corner puller, left", 0.8), ("lip corner puller, right", 0.8), ("jaw drop", 0.6)]
    for name, value in [("brow lowerer, left", 0.5), ("brow lowerer, right", 0.5), *smile]:
        tab.get_by_label(name).fill(str(value))
    tab.get_by_role("button", name="to rest", exact=True).click()
    settle(tab)
    hold_to_rasterizer(tab, tmp_path / "truth", moved=True)

    # The address keeps the state.
    before = sums(tab, 1)
    show(tab, tab.url)
    resize(tab)
    assert np.array_equal(sums(tab, 1), before)


def test_the_timeline_shows_the_motion_of_the_command(tab, tmp_path):
    srflow("view", "builtin", "--seed", 2, "-o", tmp_path / "view.html")
    show(tab, tmp_path / "view.html")
    resize(tab)
    frames = ["--timestep", 60, "--timestep-next", 61, *camera_of(tab, tmp_path)]
    srflow("rasterize", "--head", "builtin", "--seed", 2, *frames, "--out", tmp_path / "truth")
    tab.get_by_label("Frame").fill("60")
    settle(tab)
    hold_to_rasterizer(tab, tmp_path / "truth", moved=True)
    tab.keyboard.press("ArrowRight")
    assert tab.evaluate("page.state.t") == 61, "one step, by the slider alone"
    tab.locator("canvas").first.focus()
    for key, state in [("ArrowRight", ("t", 62)), ("2", ("layer", "flow")), ("a", ("arrows", True)), ("1", ("layer", "color"))]:
        tab.keyboard.press(key)
        assert tab.evaluate(f"page.state.{state[0]}") == state[1]
    tab.keyboard.press(" ")
    wait_until(tab, "page.state.t > 63")
    tab.keyboard.press(" ")
    assert tab.evaluate("page.state.playing") is False


def test_dragging_turns_and_the_wheel_zooms(tab, tmp_path):
    srflow("view", "builtin", "--seed", 2, "-o", tmp_path / "view.html")
    show(tab, tmp_path / "view.html")
    before = tab.evaluate("[page.camera.yaw, page.camera.distance]")
    tab.mouse.move(300, 300)
    tab.mouse.down()
    tab.mouse.move(240, 300)
    tab.mouse.up()
    tab.mouse.wheel(0, -400)
    settle(tab)
    yaw, distance = tab.evaluate("[page.camera.yaw, page.camera.distance]")
    assert yaw > before[0] and distance < before[1]
    assert "px" in tab.locator(".readout").inner_text()
    tab.get_by_role("button", name="Reset view").click()
    settle(tab)
    assert tab.evaluate("[page.camera.yaw, page.camera.distance]") == before


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("view") / "set"
    settings = ["--scenes", 1, "--frames", 3, "--size", "96x128", "--splits", "0,0,1", "--depth"]
    srflow("render", *settings, "--out", folder)
    return folder


def test_pairs_have_their_values_under_the_pointer(tab, tmp_path, dataset):
    srflow("view", dataset, "--method", "tvl1", "farneback", "-o", tmp_path / "pairs.html")
    show(tab, tmp_path / "pairs.html")
    assert tab.title().startswith("srflow:") and "test split" in tab.title()
    chips = tab.locator(".chips button").all_inner_texts()
    expected = ["Frame 1", "Frame 2", "True flow", "tvl1", "farneback", "Error of tvl1", "Error of farneback", "Head", "Occlusion", "Depth"]
    assert chips == expected
    tab.get_by_label("Pair").fill("2")
    settle(tab)
    truth = np.array(tab.evaluate("[...page.pair.planes.flow]")).reshape(128, 96, 2)
    files = sorted((dataset / "test" / "flow").rglob("*.npz16"))
    srflow("convert", files[2], tmp_path / "truth.flo")
    assert np.allclose(truth, read_flo(tmp_path / "truth.flo"), atol=0.005)
    np.save(tmp_path / "tvl1.npy", np.array(tab.evaluate("[...page.pair.planes.method0]"), np.float32).reshape(128, 96, 2))
    scores = srflow("metrics", tmp_path / "tvl1.npy", files[2])
    assert abs(scores["epe"] - tab.evaluate("page.pair.methods[0].epe")) < 0.002
    assert tab.evaluate("page.pair.value(page.pair.layers()[9], 48, 64)").endswith(" m")
    for chip in ["Depth", "Error of tvl1"]:
        tab.get_by_role("button", name=chip, exact=True).click()
    assert tab.locator(".panels figure").count() == 6
    box = tab.locator(".panels canvas").nth(1).bounding_box()
    tab.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    values = tab.locator(".panels figcaption span").all_inner_texts()
    assert all(value.startswith("48, 64: ") for value in values), values


def test_a_server_gives_pairs_to_this_machine_alone(tab, dataset, server):
    url = server(dataset)
    show(tab, url)
    tab.get_by_label("Pair").fill("1")
    settle(tab)
    assert tab.locator(".about").last.inner_text().endswith("00001")
    for path, headers, status in [
        ("pack/7", {}, 404),
        ("../secret", {}, 404),
        ("", {"Host": "elsewhere.example"}, 421),
    ]:
        with pytest.raises(urllib.error.HTTPError) as error:
            urllib.request.urlopen(urllib.request.Request(url + path, headers=headers))
        assert error.value.code == status


def test_a_phone_shows_picture_and_controls(browser, tmp_path):
    srflow("view", "builtin", "--seed", 2, "-o", tmp_path / "view.html")
    context = browser.new_context(viewport={"width": 390, "height": 800}, device_scale_factor=1)
    tab = context.new_page()
    tab.set_default_timeout(120_000)
    show(tab, tmp_path / "view.html")
    assert tab.evaluate("document.documentElement.scrollWidth") <= 390
    for part in ["canvas", ".controls"]:
        box = tab.locator(part).first.bounding_box()
        assert box["width"] > 380 and box["height"] > 300
    context.close()
