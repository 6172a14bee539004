#!/usr/bin/env python3
"""Writes OpenCV's flow for crates/classical/tests/classical/opencv.rs: crates/classical/tests/data.

    pip install opencv-contrib-python-headless    # made with 5.0.0.93 on x86-64 with AVX2
    python3 tools/parity/classical.py [REAL_FRAMES_DIR]

Each file is a flow field of every n-th pixel, from pixel (0, 0) on: every 8th of the synthetic pair, every 32nd of the
real ones. The synthetic pair is made by whole-number arithmetic that the test repeats.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "crates/classical/tests/data"
# (a, b, offset, half period, amplitude) of triangle waves over positions in 1/256 pixel
WAVES = [(5, 3, 100, 9000, 70), (-4, 7, 5000, 11000, 60), (9, -8, 0, 7000, 50), (2, 11, 900, 8000, 40), (13, 1, 70, 9500, 35)]


def synthetic(frame, width=160, height=120):
    y, x = np.mgrid[0:height, 0:width].astype(np.int64)
    at_x = 256 * x - frame * (384 + 2 * y)
    at_y = 256 * y - frame * (x - 200)
    image = np.zeros((height, width), np.int64)
    for a, b, offset, half, amplitude in WAVES:
        phase = (a * at_x + b * at_y + offset) % (2 * half)
        image += abs(phase - half) * amplitude // half
    return image.astype(np.uint8)


def farneback(**changes):
    names = dict(numLevels=5, pyrScale=0.5, fastPyramids=False, winSize=13, numIters=10, polyN=5, polySigma=1.1, flags=0)
    return cv2.FarnebackOpticalFlow_create(**{**names, **changes})


def tvl1(**changes):
    return cv2.optflow.DualTVL1OpticalFlow_create(**changes)


def write(name, flow, step):
    np.save(DATA / f"{name}.npy", np.ascontiguousarray(flow[::step, ::step]))
    print(f"{name}: mean motion {np.linalg.norm(flow, axis=-1).mean():.3f} px")


def main():
    DATA.mkdir(exist_ok=True)
    first, second = synthetic(0), synthetic(1)
    gaussian = dict(winSize=15, polyN=7, polySigma=1.5, pyrScale=0.6, flags=cv2.OPTFLOW_FARNEBACK_GAUSSIAN)
    write("synthetic_farneback", farneback().calc(first, second, None), 8)
    write("synthetic_farneback_gaussian", farneback(**gaussian).calc(first, second, None), 8)
    write("synthetic_tvl1", tvl1().calc(first, second, None), 8)
    write("synthetic_tvl1_gamma", tvl1(gamma=0.3, medianFiltering=3, scaleStep=0.5).calc(first, second, None), 8)

    frames = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "../shared/data/real-frames"
    if not frames.is_dir():
        sys.exit(f"{frames}: no such folder; the real frames are left out")
    pairs = {
        "sintel_16": ("sintel/frame_0016.png", "sintel/frame_0017.png"),
        "sintel_17": ("sintel/frame_0017.png", "sintel/frame_0018.png"),
        "kitti": ("kitti/frame1.png", "kitti/frame2.png"),
    }
    for name, (one, two) in pairs.items():
        first, second = (cv2.cvtColor(cv2.imread(str(frames / f)), cv2.COLOR_BGR2GRAY) for f in (one, two))
        write(f"{name}_farneback", farneback().calc(first, second, None), 32)
        flow = tvl1().calc(first, second, None)
        if name != "kitti":  # there the test compares errors against the truth
            write(f"{name}_tvl1", flow, 32)
    truth = cv2.imread(str(frames / "kitti/flow_gt.png"), cv2.IMREAD_UNCHANGED)[..., ::-1].astype(np.float64)
    valid = truth[..., 2] > 0
    error = np.linalg.norm(flow - (truth[..., :2] - 32768) / 64, axis=-1)[valid].mean()
    (DATA / "kitti_tvl1_epe.txt").write_text(f"{error:.6f}\n")
    print(f"TV-L1 on KITTI: end-point error {error:.4f} px")


if __name__ == "__main__":
    main()
