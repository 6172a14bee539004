#!/usr/bin/env python3
"""Times srflow's classical estimators against OpenCV's, in turn, on the same frames and threads.

    pip install opencv-contrib-python-headless
    cargo build --release
    python3 tools/bench/classical.py [--size 1600x1200] [--threads 2] [--repeats 3] [--frame FRAME]

The first frame is a texture made here, or --frame resized; the second is the first warped by a smooth flow of a few
pixels. Both programs' times are those of the estimation alone, frames already in memory. Prints the median seconds of
both, their ratio, and the mean distance between the flows.
"""

import argparse
import json
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import cv2
import history
import numpy as np

ROOT = Path(__file__).resolve().parents[2]


def frames(width, height, path):
    if path:
        first = cv2.resize(cv2.imread(path), (width, height), interpolation=cv2.INTER_CUBIC)
    else:
        random = np.random.default_rng(7)
        octaves = [cv2.resize(random.random((height // s + 2, width // s + 2, 3)), (width, height)) for s in (2, 5, 13, 40)]
        first = np.clip(255 * sum(octaves) / len(octaves), 0, 255).astype(np.uint8)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    u = 3 * np.sin(x / 170) + 2 * np.cos(y / 130)
    v = 2 * np.cos(x / 210) - 3 * np.sin(y / 190)
    return first, cv2.remap(first, x - u, y - v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="1600x1200", help="WIDTHxHEIGHT")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--frame", help="an image in place of the made texture")
    parser.add_argument("--methods", nargs="+", default=["farneback", "tvl1"])
    parser.add_argument("--srflow", default=str(ROOT / "target/release/srflow"))
    args = history.parse(parser)
    width, height = map(int, args.size.split("x"))
    cv2.setNumThreads(args.threads)
    first, second = frames(width, height, args.frame)
    grey = [cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) for frame in (first, second)]

    print(f"{width}x{height}, {args.threads} threads, OpenCV {cv2.__version__}, median of {args.repeats}")
    for method in args.methods:
        ours, theirs = [], []
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            names = [str(folder / "1.png"), str(folder / "2.png")]
            for name, frame in zip(names, (first, second)):
                cv2.imwrite(name, frame)
            for _ in range(args.repeats):
                peer = (cv2.FarnebackOpticalFlow_create if method == "farneback" else cv2.optflow.DualTVL1OpticalFlow_create)()
                start = time.perf_counter()
                expected = peer.calc(*grey, None)
                theirs.append(time.perf_counter() - start)
                command = [args.srflow, "flow", "--method", method, *names, "-o", str(folder / "flow.npy")]
                command += ["--force", "--json", "--threads", str(args.threads)]
                report = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
                ours.append(report["pairs"][0]["seconds"])
            distance = np.linalg.norm(np.load(folder / "flow.npy") - expected, axis=-1).mean()
        us, them = statistics.median(ours), statistics.median(theirs)
        print(f"{method:10} srflow {us:7.3f} s   OpenCV {them:7.3f} s   {them / us:5.1f} times   mean distance {distance:.5f} px", flush=True)
        if args.record:
            note = f"s; {method} at {args.size}; OpenCV {cv2.__version__}; mean distance {distance:.5f} px"
            history.append("classical", us, them, note)


if __name__ == "__main__":
    main()
