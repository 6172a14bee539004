import _thread
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import srflow


def error_of(flow, motion):
    """Mean end-point error away from the border."""
    return np.linalg.norm(flow[10:-10, 10:-10] - np.array(motion), axis=-1).mean()


@pytest.mark.parametrize("method", [None, "srflow", "tvl1", "farneback"])
def test_flow_is_the_motion_between_the_frames(frames, method):
    first, second, motion = frames
    flow = srflow.flow(first, second, method)
    assert flow.dtype == np.float32 and flow.shape == (64, 96, 2)
    assert error_of(flow, motion) < 0.3


def test_options_are_those_of_the_command(frames, tmp_path, command):
    first, second, _ = frames
    for name, image in [("a.ppm", first), ("b.ppm", second)]:
        (tmp_path / name).write_bytes(b"P6 96 64 255\n" + image.tobytes())
    options = ["--method", "tvl1", "--warps", "2", "--lambda", "0.1", "--refine"]
    ran = command("flow", tmp_path / "a.ppm", tmp_path / "b.ppm", "-o", tmp_path / "flow.flo", *options)
    assert ran.returncode == 0, ran.stderr
    flow = srflow.flow(first, second, "tvl1", warps=2, refine=True, **{"lambda": 0.1})
    assert np.array_equal(flow, srflow.read_flow(tmp_path / "flow.flo"))
    assert not np.array_equal(flow, srflow.flow(first, second, "tvl1"))


def test_arrays_of_any_layout_and_kind_are_taken(frames):
    first, second, _ = frames
    expected = srflow.flow(first, second, "farneback")
    for change in [np.asfortranarray, lambda x: x[::-1][::-1], lambda x: np.repeat(x, 2, axis=1)[:, ::2]]:
        assert np.array_equal(srflow.flow(change(first), change(second), "farneback"), expected)
    grey = srflow.flow(first[..., 0], second[..., 0], "farneback")
    assert np.array_equal(grey, srflow.flow(first[..., [0, 0, 0]], second[..., [0, 0, 0]], "farneback"))

    class OnlyDlpack:
        def __init__(self, array):
            self.array = array

        def __dlpack__(self, **arguments):
            return self.array.__dlpack__(**arguments)

        def __dlpack_device__(self):
            return self.array.__dlpack_device__()

    assert np.array_equal(srflow.flow(OnlyDlpack(first), OnlyDlpack(second), "farneback"), expected)


def test_tensors_of_pytorch_are_taken(frames):
    torch = pytest.importorskip("torch", reason="pytorch: not installed")
    first, second, _ = frames
    flow = srflow.flow(torch.from_numpy(first), torch.from_numpy(second), "farneback")
    assert np.array_equal(flow, srflow.flow(first, second, "farneback"))
    assert torch.from_numpy(flow).dtype == torch.float32


def test_farneback_is_that_of_opencv(frames):
    cv2 = pytest.importorskip("cv2", reason="opencv: not installed")
    first, second, _ = frames
    grey = [cv2.cvtColor(x, cv2.COLOR_RGB2GRAY) for x in (first, second)]
    theirs = cv2.calcOpticalFlowFarneback(*grey, None, 0.5, 6, 13, 10, 5, 1.1, 0)
    assert np.abs(srflow.flow(first, second, "farneback") - theirs).mean() < 0.01


@pytest.mark.parametrize(
    "arguments, message",
    [
        (lambda a, b: (a, b[:32]), "the frames differ in size: the first is 96x64, the second 96x32"),
        (lambda a, b: (a, b.astype(np.float32)), "frame2: expected an image, uint8 .* found float32 64 x 96 x 3"),
        (lambda a, b: (a.transpose(2, 0, 1), b), "frame1: expected an image, .* found uint8 3 x 64 x 96"),
        (lambda a, b: (a[:0], b), "frame1: expected an image, .* found uint8 0 x 96 x 3"),
        (lambda a, b: (a, b, "pwc"), "unknown method `pwc`; the methods are farneback, tvl1, srflow"),
        (lambda a, b: (a, b, "raft"), "raft needs weights"),
    ],
)
def test_wrong_arguments_are_value_errors_that_say_what_was_expected(frames, arguments, message):
    with pytest.raises(ValueError, match=message):
        srflow.flow(*arguments(*frames[:2]))


def test_wrong_options_are_value_errors(frames):
    first, second, _ = frames
    with pytest.raises(ValueError, match="unknown setting `wraps`"):
        srflow.flow(first, second, "tvl1", wraps=2)
    with pytest.raises(ValueError, match="`warps`"):
        srflow.flow(first, second, "tvl1", warps=0.5)
    with pytest.raises(ValueError, match="`tvl1` is no network; the networks are srflow, raft"):
        srflow.Network("tvl1")
    with pytest.raises(FileNotFoundError, match="nowhere.pth: not a file"):
        srflow.Network("raft", "nowhere.pth")


def test_a_network_is_loaded_once_and_gives_the_same_flow(frames):
    first, second, motion = frames
    network = srflow.Network(iters=1)
    flow = network(first, second)
    assert repr(network) == 'srflow.Network("srflow")'
    assert np.array_equal(flow, srflow.flow(first, second, iters=1))
    assert not np.array_equal(flow, srflow.flow(first, second))
    assert np.array_equal(srflow.Network(iters="auto")(first, second), srflow.flow(first, second))
    assert error_of(network(first, second, initial=np.full((64, 96, 2), motion)), motion) < 0.3


def test_a_sequence_gives_the_flow_of_each_pair_and_its_uncertainty(frames):
    first, second, _ = frames
    network = srflow.Network()
    sequence = network.sequence()
    assert sequence.push(first) is None
    for before, after in [(first, second), (second, first)]:
        found = sequence.push(after)
        assert np.array_equal(found["flow"], network(before, after))
        assert found["uncertainty"].shape == (64, 96) and found["uncertainty"].min() > 0
        assert found["iterations"] == 2
    with pytest.raises(ValueError, match="differ in size"):
        sequence.push(first[:32])


def test_an_interrupted_sequence_gives_no_flow_of_another_frame():
    frames = np.random.default_rng(1).integers(0, 256, (2, 1200, 1600, 3), dtype=np.uint8)
    sequence = srflow.Network().sequence()
    sequence.push(frames[0])
    timer = threading.Timer(0.2, _thread.interrupt_main)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        sequence.push(frames[1])
    timer.join()
    with pytest.raises(ValueError, match="this sequence was interrupted within a frame: begin another one"):
        sequence.push(frames[0])


INTERRUPTED = """
import numpy as np, srflow
frames = np.random.default_rng(1).integers(0, 256, (2, 3000, 4000, 3), dtype=np.uint8)
print("begun", flush=True)
try:
    srflow.flow(*frames, "tvl1")
except KeyboardInterrupt:
    print("interrupted", flush=True)
    import os
    os._exit(3)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals: Windows has none to send")
def test_ctrl_c_interrupts_an_estimation():
    process = subprocess.Popen([sys.executable, "-c", INTERRUPTED], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "begun\n"
    time.sleep(1)
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=120)[0] == "interrupted\n"
    assert process.returncode == 3
