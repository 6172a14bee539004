#!/usr/bin/env python3
"""Golden data of srflow-mer's preprocessing: optical strain and bicubic resizing as OpenCV computes them.

Writes crates/mer/tests/data/preprocessing/. Needs numpy and opencv-python:

    tools/golden/strain.py

Made with numpy 2.4.6, OpenCV 5.0.0 (4.13 gives the same).
"""

from pathlib import Path

import cv2
import numpy as np

DATA = Path(__file__).resolve().parents[2] / "crates/mer/tests/data/preprocessing"


def flow(height, width):
    random = np.random.default_rng(3)
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    u = 0.8 * np.sin(0.31 * x + 0.17 * y) + random.normal(0, 0.2, (height, width))
    v = 0.6 * np.cos(0.23 * x - 0.29 * y) + random.normal(0, 0.2, (height, width))
    return np.stack([u, v], -1).astype(np.float32)


def derivatives(flow):
    sobel = lambda plane, dx, dy: cv2.Sobel(plane, cv2.CV_32F, dx, dy)
    u, v = flow[..., 0].copy(), flow[..., 1].copy()
    return sobel(u, 1, 0), sobel(u, 0, 1), sobel(v, 1, 0), sobel(v, 0, 1)


def literature(flow):
    """Liong et al. 2014, with derivatives per pixel."""
    ux, uy, vx, vy = (d / np.float32(8) for d in derivatives(flow))
    return np.sqrt(ux * ux + vy * vy + 0.5 * (uy + vx) * (uy + vx))


def off_tanet(flow):
    """data.py of Off-TANet (PRICAI 2021), line by line."""
    ux, uy, vx, vy = derivatives(flow)
    return np.sqrt(ux * ux + uy * uy + 0.5 * (vx + uy) * (vx + uy))


def picture(height, width):
    random = np.random.default_rng(4)
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    wave = 128 + 90 * np.sin(0.21 * x + 0.8 * np.sin(0.13 * y))
    image = wave[..., None] + random.normal(0, 40, (height, width, 3))
    image[2:9, 3:14] = 255  # edges, past which a cubic overshoots
    image[9:15, 3:14] = 0
    return np.clip(np.round(image), 0, 255).astype(np.uint8)


def main():
    DATA.mkdir(parents=True, exist_ok=True)
    small = flow(17, 23)
    arrays = {"flow": small, "literature": literature(small), "off_tanet": off_tanet(small)}
    large = picture(31, 43)
    arrays["picture"] = large
    arrays["shrunk"] = cv2.resize(large, (24, 13), interpolation=cv2.INTER_CUBIC)
    arrays["grown"] = cv2.resize(large, (57, 40), interpolation=cv2.INTER_CUBIC)
    for name, array in arrays.items():
        np.save(DATA / f"{name}.npy", array.astype(np.float32))


if __name__ == "__main__":
    main()
