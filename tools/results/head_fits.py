"""docs/explanation/micro-expression-protocol.md: which part of the face the head's motion is fitted to.

    pip install numpy
    srflow mer synth --look 1 --subjects 8 --clips 12 --side 192 --fps 60 --noise 2 --drift 2 --lighting 2 --only-key-frames --intensity 0.25 --out set
    srflow mer features --data clips:set --only-key-frames --method srflow farneback --head-motion keep --out set.npz
    python tools/results/head_fits.py set set.npz

Prints the mean error of the expression's flow in the face for each part, in pixels of 112x112.
"""

import csv
import sys
from pathlib import Path

import numpy as np

SIDE = 112
Y, X = np.mgrid[0:SIDE, 0:SIDE]
FACE = ((X + 0.5) / SIDE - 0.5) ** 2 / 0.365**2 + ((Y + 0.5) / SIDE - 0.5) ** 2 / 0.5**2 < 1


def fitted(flow, weights, degree):
    """A polynomial of the place with the weights of Geman and McClure, as `SurfaceMotion`."""
    x, y = (2 * axis / (SIDE - 1) - 1 for axis in (X, Y))
    terms = [np.ones_like(x), x, y] + [x * x, x * y, y * y] * (degree == 2)
    terms = np.stack(terms, -1).reshape(SIDE * SIDE, -1)
    used = weights.ravel() > 0
    a, b, given = terms[used], flow.reshape(-1, 2)[used], weights.ravel()[used]
    rest, scale = np.zeros(len(b)), np.inf
    for _ in range(24):
        counts = (given / (1 + rest / scale**2) ** 2)[:, None]
        motion = np.linalg.solve(a.T @ (counts * a), a.T @ (counts * b))
        rest = ((b - a @ motion) ** 2).sum(1)
        deviation = max(np.sqrt(np.median(rest) / (2 * np.log(2))), 1e-3)
        scale = max(min(scale / 2, np.sqrt(rest.max())), 2 * deviation)
    return (terms @ motion).reshape(SIDE, SIDE, 2)


def read_flow(path):
    """A .flo file, averaged down to 112x112, in its pixels."""
    data = path.read_bytes()
    width, height = np.frombuffer(data, "<i4", 2, 4)
    flow = np.nan_to_num(np.frombuffer(data, "<f4", 2 * width * height, 12).reshape(height, width, 2).astype(float))
    for axis in (0, 1):
        sums = np.concatenate([np.zeros_like(flow[:1]), np.cumsum(flow, 0)])
        at = np.linspace(0, len(flow), SIDE + 1)
        floor = np.minimum(at.astype(int), len(flow) - 1)
        part = (at - floor)[:, None, None]
        sums = sums[floor] * (1 - part) + sums[floor + 1] * part
        flow = (np.diff(sums, axis=0) * SIDE / len(flow)).swapaxes(0, 1)
    return flow * SIDE / width


def main(folder, archive):
    features = np.load(archive)
    landmarks = {(row["subject"], row["clip"]): row for row in csv.DictReader((folder / "landmarks.csv").open())}
    sizes = {}
    errors = {}
    for maps, method, subject, clip in zip(*(features[key] for key in ("X", "method", "subject", "clip"))):
        row = landmarks[subject, clip]
        if clip not in sizes:
            sizes[clip] = np.frombuffer((folder / f"{clip}_flow.flo").read_bytes(), "<i4", 1, 4)[0]
        points = np.array([[float(row[f"{axis}_{point}"]) for axis in "xy"] for point in range(68)]) * SIDE / sizes[clip]
        apart = np.linalg.norm(points[45] - points[36])
        near = lambda places: np.any([np.hypot(X - x, Y - y) < 0.12 * apart for x, y in places], axis=0)
        between = lambda pairs: [(points[a] + points[b]) / 2 for a, b in pairs]
        still = near([*points[27:31], *between([(27, 39), (27, 42), (0, 36), (16, 45), (1, 36), (15, 45)])])
        mobile = near([*points[17:27], *points[36:60]])
        flow = maps[:2].transpose(1, 2, 0).astype(float)
        whole, expression = (read_flow(folder / f"{clip}_{kind}.flo") for kind in ("flow", "expression_flow"))
        left = {
            "whole face": flow - fitted(flow, FACE * 1.0, 2) - expression,
            "without brows, lids and mouth": flow - fitted(flow, (FACE & ~mobile) * 1.0, 2) - expression,
            "nose and temples (affine)": flow - fitted(flow, still * 1.0, 1) - expression,
            "nothing: the flow's own error": flow - whole,
        }
        for part, error in left.items():
            errors.setdefault((method, part), []).append(np.linalg.norm(error, axis=-1)[FACE].mean())
    for (method, part), values in errors.items():
        print(f"{method}, {part}: {np.mean(values):.3f} px, {len(values)} clips")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
