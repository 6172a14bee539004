"""Expressions in videos: jobs whose results are arrays and dicts, not files."""

import contextlib
import csv
import tempfile
from pathlib import Path

import numpy as np

from . import jobs


def spot(video, *, out=None, **options):
    """Spots expressions in a video, or in a folder of frames.

    Options are those of `srflow mer spot`: `fps=30`, `face="detect"`. Its files go to the folder `out`, if there is one.

    Returns a dict: `events`, a list of dicts with frames, seconds, region and strength; `regions`, the names of 16 regions of the face; and
    `curves`, arrays of N frames: `frame` (int64), `seconds` (float64), `usable` (bool: a face is seen and does not move fast), `head`
    (float64, N x 2: motion of the head) and `regions` (float64, N x 16 x 2: motion without that of the head), in pixels, right and down; and
    `units`, a dict of arrays by the numbers of action units (float64, N: how far the face moves as that unit does, in pixels).
    """
    with contextlib.ExitStack() as stack:
        folder = out if out is not None else stack.enter_context(tempfile.TemporaryDirectory())
        (spotted,) = jobs.mer_spot(video, folder, **options)["videos"]
        names, curves = _curves(Path(folder) / f"{spotted['video']}.frames.csv")
    return {"events": spotted["events"], "regions": names, "curves": curves}


def predict(model, inputs, *, out=None, **options):
    """Classifies expressions in videos or clips with a trained model.

    `model` is the folder of a model that `srflow mer run` saved, or "rendered". `inputs` is a video, a folder of frames, a dataset KIND:DIR,
    or a list of them. Options are those of `srflow mer predict`: `clips=True`, `face="detect"`. Its files go to the folder `out`, if there is one.

    Returns a list of dicts: where the expression is, its `class` (None if the model does not know, and `doubt` says why) and the
    `probabilities` of the classes.
    """
    with contextlib.ExitStack() as stack:
        folder = out if out is not None else stack.enter_context(tempfile.TemporaryDirectory())
        return jobs.mer_predict(model, inputs, folder, **options)["expressions"]


def _curves(path):
    """Reads the motion of the regions: their names and arrays."""
    with open(path, newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    units = [column for column in header if column.startswith("au")]
    end = len(header) - len(units)
    names = [column.removesuffix("_x") for column in header[5:end:2]]
    motion = np.array([row[3:end] for row in rows], np.float64).reshape(len(rows), 1 + len(names), 2)
    moved = np.array([row[end:] for row in rows], np.float64)
    curves = {
        "frame": np.array([row[0] for row in rows], np.int64),
        "seconds": np.array([row[1] for row in rows], np.float64),
        "usable": np.array([row[2] == "yes" for row in rows], bool),
        "head": motion[:, 0],
        "regions": motion[:, 1:],
        "units": {int(unit.removeprefix("au")): moved[:, at] for at, unit in enumerate(units)},
    }
    return names, curves
