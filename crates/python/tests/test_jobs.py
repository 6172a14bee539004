import _thread
import json
import threading
import time

import pytest

import srflow

RENDERING = {"scenes": 2, "frames": 4, "size": "96x128", "splits": "0.5,0.5,0"}


def files(folder):
    return {path.relative_to(folder): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """A dataset of eight pairs, and what was reported."""
    folder, reports = tmp_path_factory.mktemp("rendered") / "data", []
    result = srflow.render(folder, callback=reports.append, **RENDERING)
    assert result["made"] == result["pairs"] == 8 and not result["stopped"]
    return folder, reports


class Enough(Exception):
    pass


def test_rendering_is_that_of_the_command(rendered, tmp_path, command):
    folder, reports = rendered
    options = [word for name, value in RENDERING.items() for word in (f"--{name}", value)]
    ran = command("render", "--out", tmp_path / "data", "--json", *options)
    assert ran.returncode == 0, ran.stderr
    assert files(tmp_path / "data") == files(folder)
    assert [report["done"] for report in reports] == list(range(9))
    assert all(report["total"] == 8 for report in reports) and reports[-1]["bytes"] > 0
    again = srflow.render(folder, **RENDERING)
    assert (again["made"], again["statistics"]) == (0, json.loads(ran.stdout)["statistics"])


def test_an_exception_stops_rendering_and_the_same_call_continues(rendered, tmp_path):
    def enough(report):
        if report["done"] == 3:
            raise Enough

    with pytest.raises(Enough):
        srflow.render(tmp_path / "data", callback=enough, **RENDERING)
    reports = []
    result = srflow.render(tmp_path / "data", callback=reports.append, **RENDERING)
    assert 3 <= reports[0]["done"] < 8 and result["made"] == 8 - reports[0]["done"]
    assert files(tmp_path / "data") == files(rendered[0])


def test_ctrl_c_stops_rendering(tmp_path):
    timer = threading.Timer(1, _thread.interrupt_main)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        srflow.render(tmp_path / "data", scenes=1, frames=2000, size="96x128")
    timer.join()
    at_once = len(files(tmp_path / "data"))
    time.sleep(1)
    assert len(files(tmp_path / "data")) == at_once


def test_a_callback_may_compute(rendered, tmp_path):
    dataset = srflow.Dataset(f"srflow:{rendered[0]}", split="all")
    pair, flows = dataset[0], []

    def estimate(report):
        flows.append(srflow.flow(pair["frame1"], pair["frame2"], "farneback"))

    srflow.render(tmp_path / "data", callback=estimate, scenes=1, frames=1, size="96x128")
    assert len(flows) == 2


def test_wrong_options_of_rendering_are_errors(rendered, tmp_path):
    with pytest.raises(TypeError, match="unexpected keyword argument 'scene'"):
        srflow.render(tmp_path / "data", scene=3)
    with pytest.raises(ValueError, match="frames=0: expected 1 to 99999"):
        srflow.render(tmp_path / "data", frames=0)
    with pytest.raises(ValueError, match="expected a folder to write into, found the name of a file"):
        srflow.render(tmp_path / "data.zip")
    with pytest.raises(ValueError, match="the folder has a dataset with"):
        srflow.render(rendered[0], scenes=5, frames=1)
    with pytest.raises(TypeError, match="callback: expected a function, found int"):
        srflow.render(tmp_path / "data", callback=3)
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="file/data: .*; a dataset needs a folder that can be created") as refused:
        srflow.render(tmp_path / "file/data", scenes=1, frames=1)
    assert not isinstance(refused.value, FileNotFoundError)
    with pytest.raises(FileNotFoundError, match="`head` .*nowhere"):
        srflow.render(tmp_path / "data", head=f"ict:{tmp_path / 'nowhere'}")
    assert not (tmp_path / "data").exists()


def training(rendered, **more):
    settings = {"data": f"srflow:{rendered[0]}", "crop": "64x64", "batch": 1, "iterations": 2, "steps": 4, "seed": 5}
    return settings | {"set": {"checkpoints.every": 4, "validation.every": 4}} | more


@pytest.fixture(scope="module")
def trained(rendered, tmp_path_factory):
    """A run of four steps, what was reported, and the result."""
    run, reports = tmp_path_factory.mktemp("trained") / "run", []
    result = srflow.train("cpu-small", run, callback=reports.append, **training(rendered))
    return run, reports, result


def test_training_is_that_of_the_command(rendered, trained, tmp_path, command):
    run, reports, result = trained
    arguments = ["--config", "cpu-small", "--data", f"srflow:{rendered[0]}", "--crop", "64x64", "--batch", 1]
    arguments += ["--iterations", 2, "--steps", 4, "--seed", 5, "--set", "checkpoints.every=4", "--set", "validation.every=4"]
    ran = command("train", "--out", tmp_path / "run", *arguments)
    assert ran.returncode == 0, ran.stderr
    for name in ["last.safetensors", "best.safetensors", "config.toml"]:
        assert (tmp_path / "run" / name).read_bytes() == (run / name).read_bytes(), name
    assert (run / "report.html").exists()
    assert (result["steps"], result["stopped"], result["weights"]) == (4, False, str(run / "best.safetensors"))

    assert [report["event"] for report in reports] == ["started", *["step"] * 4, "validation", "saved"]
    assert [report["done"] for report in reports] == [0, 1, 2, 3, 4, 4, 4] and {report["total"] for report in reports} == {4}
    assert reports[0]["parameters"] > 100_000 and reports[1]["loss"] > 0 and reports[1]["parts"]
    assert reports[5]["whole"]["epe"] > 0 and reports[6]["path"].endswith("step-00000004")
    flow = srflow.Network("raft-small", result["weights"], iters=2)
    pair = srflow.Dataset(f"srflow:{rendered[0]}", split="val")[0]
    assert flow(pair["frame1"], pair["frame2"]).shape == (128, 96, 2)


def test_an_exception_stops_training_with_a_checkpoint(rendered, trained, tmp_path):
    def enough(report):
        if report["event"] == "step" and report["done"] == 2:
            raise Enough

    with pytest.raises(Enough):
        srflow.train("cpu-small", tmp_path / "run", callback=enough, **training(rendered))
    assert [path.name for path in (tmp_path / "run/checkpoints").iterdir()] == ["step-00000002"]
    reports = []
    result = srflow.train(resume=tmp_path / "run", callback=reports.append)
    assert reports[0]["done"] == 2 and result["steps"] == 4
    for name in ["last.safetensors", "best.safetensors"]:
        assert (tmp_path / "run" / name).read_bytes() == (trained[0] / name).read_bytes(), name


def test_ctrl_c_stops_training_with_a_checkpoint(rendered, tmp_path):
    begun = threading.Event()

    def interrupt():
        begun.wait()
        time.sleep(0.3)
        _thread.interrupt_main()

    thread = threading.Thread(target=interrupt)
    thread.start()
    reports = []

    def note(report):
        reports.append(report)
        if report["event"] == "step":
            begun.set()

    with pytest.raises(KeyboardInterrupt):
        srflow.train("cpu-small", tmp_path / "run", callback=note, **training(rendered, steps=100_000))
    thread.join()
    last = max((tmp_path / "run/checkpoints").iterdir()).name
    done = int(last.removeprefix("step-"))
    assert done >= reports[-1]["done"] >= 1
    assert done < 100_000 and not (tmp_path / "run/report.html").exists()


def test_a_configuration_is_a_dict(rendered):
    config = srflow.train("cpu-small", print_config=True, set={"training.clip": 0.5, "network.batch_norm": "live"})
    assert config["training"]["clip"] == 0.5 and config["network"]["architecture"] == "raft-small"


def test_wrong_options_of_training_are_errors(rendered, trained, tmp_path):
    with pytest.raises(ValueError, match="out"):
        srflow.train("cpu-small")
    with pytest.raises(FileNotFoundError, match="nothing: opening: .*; pass a TOML file or one of the presets: skflow, "):
        srflow.train("nothing", tmp_path / "run")
    with pytest.raises(FileNotFoundError, match="srflow: looked for .*nowhere"):
        srflow.train("cpu-small", tmp_path / "run", data=f"srflow:{tmp_path / 'nowhere'}", crop="64x64")
    with pytest.raises(FileNotFoundError, match="nowhere.pth: not a file, nor the name of published weights"):
        srflow.train("cpu-small", tmp_path / "run", weights="nowhere.pth", **training(rendered))
    with pytest.raises(ValueError, match="nowhere/checkpoints: found no checkpoint to continue from"):
        srflow.train(resume=tmp_path / "nowhere")
    with pytest.raises(TypeError, match="unexpected keyword argument 'step'"):
        srflow.train("cpu-small", tmp_path / "run", step=3)
    with pytest.raises(ValueError, match="already contains a run of 4 steps"):
        srflow.train("cpu-small", trained[0], **training(rendered))
    with pytest.raises(ValueError, match="`resume` continues with the configuration of the run"):
        srflow.train(resume=trained[0], steps=5)
