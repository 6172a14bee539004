"""Facial optical flow: estimate, score, read and render it; avatars of 3D Gaussians; micro-expressions.

>>> import srflow
>>> flow = srflow.flow(frame1, frame2)  # uint8 H x W x 3 each -> float32 H x W x 2

>>> avatar = srflow.Avatar.builtin(7)
>>> rest, smile = avatar.pose(), avatar.pose({12: 0.8})
>>> frame = srflow.rasterize(rest, srflow.Camera.facing(rest), next=smile)
>>> frame["image"], frame["flow"]  # a picture, and its exact flow
"""

from . import jobs, mer

from ._srflow import (
    Avatar,
    Camera,
    Dataset,
    FaceFinder,
    Gaussians,
    Network,
    Sequence,
    __version__,
    consistency,
    crop_face,
    flow,
    flow_to_rgb,
    metrics,
    rasterize,
    rasterize_backward,
    read_flow,
    warp,
    write_flow,
)
from ._report import Report
from .jobs import render, train


__all__ = [
    "Avatar",
    "Camera",
    "Dataset",
    "FaceFinder",
    "Gaussians",
    "Network",
    "Report",
    "Sequence",
    "consistency",
    "crop_face",
    "flow",
    "flow_to_rgb",
    "jobs",
    "mer",
    "metrics",
    "rasterize",
    "rasterize_backward",
    "read_flow",
    "render",
    "train",
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
