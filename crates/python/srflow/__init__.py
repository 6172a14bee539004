"""Facial optical flow: estimate, score and read it.

>>> import srflow
>>> flow = srflow.flow(frame1, frame2)  # uint8 H x W x 3 each -> float32 H x W x 2
"""

from ._srflow import (
    Dataset,
    Network,
    Sequence,
    __version__,
    consistency,
    flow,
    flow_to_rgb,
    metrics,
    read_flow,
    warp,
    write_flow,
)

__all__ = [
    "Dataset",
    "Network",
    "Sequence",
    "consistency",
    "flow",
    "flow_to_rgb",
    "metrics",
    "read_flow",
    "warp",
    "write_flow",
]


def _main():
    """The command `srflow`."""
    import signal
    import sys

    from ._srflow import run

    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Python's own handler would wait for the command's end
    sys.exit(run(["srflow", *sys.argv[1:]]))
