import signal
import subprocess
import sys

import numpy as np
import pytest

# Shells start programs in the background with Ctrl-C ignored, and these tests press it.
signal.signal(signal.SIGINT, signal.default_int_handler)


def frame(u, v, width=96, height=64):
    """Waves of a few pixels, moved by (u, v)."""
    y, x = np.mgrid[:height, :width].astype(float)
    x, y = x - u, y - v
    waves = [np.sin(0.4 * x + 0.1 * c * y) * np.cos(0.3 * y) + 0.5 * np.sin(0.7 * y - 0.2 * x) for c in range(3)]
    return (127.5 + 60 * np.stack(waves, axis=-1)).astype(np.uint8)


@pytest.fixture
def frames():
    """Two frames, and the motion between them."""
    return frame(0, 0), frame(1.5, -0.75), (1.5, -0.75)


@pytest.fixture(scope="session")
def command():
    """Runs `srflow` with these arguments, in a process of its own."""

    def run(*arguments):
        arguments = [sys.executable, "-m", "srflow", *map(str, arguments)]
        return subprocess.run(arguments, capture_output=True, text=True, timeout=300)

    return run


@pytest.fixture(scope="session")
def shapes(tmp_path_factory, command):
    """A dataset of four pairs."""
    folder = tmp_path_factory.mktemp("data") / "shapes"
    made = command("shapes", "--out", folder, "--pairs", 4, "--size", "96x64")
    assert made.returncode == 0, made.stderr
    return folder
