"""docs/explanation/micro-expression-protocol.md: what magnified motion does to recognition.

    pip install numpy scipy pillow
    srflow mer synth --look 1 --subjects 8 --clips 12 --side 192 --fps 60 --noise 2 --drift 2 --lighting 2 --only-key-frames --intensity 0.15 --out set
    python tools/results/magnified_clips.py set magnified phase 3
    srflow mer run --data clips:magnified --only-key-frames --method srflow farneback --out results

Copies a set of clips whose apex frames show FACTOR times the motion from the onset: `linear`, what Wu et al. (2012) do to brightness, or
`phase`, with the Riesz pyramid of Wadhwa et al. (2014).
"""

import csv
import shutil
import sys
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import correlate1d, gaussian_filter

LEVELS = 4
SIGMA = 1.0


def linear(onset, apex, factor):
    return onset + factor * gaussian_filter(apex - onset, (SIGMA, SIGMA, 0))


def expand(image, shape):
    wide = np.zeros(shape)
    wide[::2, ::2] = image
    return 4 * gaussian_filter(wide, 1)


def laplacian(image):
    bands = []
    for _ in range(LEVELS):
        small = gaussian_filter(image, 1)[::2, ::2]
        bands.append(image - expand(small, image.shape))
        image = small
    return bands, image


def riesz(band):
    """Band, and its parts in quadrature along columns and rows."""
    kernel = [0.5, 0, -0.5]
    return band, correlate1d(band, kernel, axis=1), correlate1d(band, kernel, axis=0)


def phase(onset, apex, factor):
    (first, _), (second, rest) = laplacian(onset.mean(2)), laplacian(apex.mean(2))
    for one, other in zip(first[::-1], second[::-1]):
        (p, px, py), (q, qx, qy) = riesz(one), riesz(other)
        real, x, y = q * p + qx * px + qy * py, qx * p - q * px, qy * p - q * py
        across = np.hypot(x, y) + 1e-12
        angle = np.arctan2(across, real) / across
        amplitude = np.sqrt(p * p + px * px + py * py) + 1e-9
        mean = lambda phase: gaussian_filter(phase * amplitude, SIGMA) / gaussian_filter(amplitude, SIGMA)
        x, y = factor * mean(angle * x), factor * mean(angle * y)
        turn = np.hypot(x, y) + 1e-12
        rest = expand(rest, one.shape) + p * np.cos(turn) - (x * px + y * py) / turn * np.sin(turn)
    return onset + (rest - onset.mean(2))[..., None]


def main(source, target, how, factor):
    target.mkdir(parents=True)
    for name in ("clips.csv", "landmarks.csv"):
        shutil.copy(source / name, target / name)
    for row in csv.DictReader((source / "clips.csv").open()):
        paths = [Path(row["clip"], f"{int(row[frame]):04}.png") for frame in ("onset", "apex")]
        onset, apex = (np.asarray(Image.open(source / path).convert("RGB"), float) for path in paths)
        magnified = {"linear": linear, "phase": phase}[how](onset, apex, factor)
        (target / row["clip"]).mkdir(parents=True)
        for path, image in zip(paths, (onset, magnified)):
            Image.fromarray(np.clip(np.round(image), 0, 255).astype(np.uint8)).save(target / path)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], float(sys.argv[4]))
