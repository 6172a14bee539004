#!/usr/bin/env python3
"""Times Farneback's flow along a folder of PNGs, files included, against the loop that people write with OpenCV.

    pip install opencv-python-headless
    cargo build --release
    python3 tools/bench/folder.py [--size 1600x1200] [--frames 16] [--threads 2] [--repeats 3]

Both programs read every frame once and write a .flo file for each pair; in turn, each of them `--repeats` times. srflow's time is that of
the whole process, OpenCV's that of the loop. The frames are a texture made here, with noise, so that PNG has something to do.
"""

import argparse
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import cv2
import history
import numpy as np
from classical import ROOT, frames


def loop(names, out):
    flow = cv2.FarnebackOpticalFlow_create()
    before = None
    for name in names:
        grey = cv2.cvtColor(cv2.imread(str(name)), cv2.COLOR_BGR2GRAY)
        if before is not None:
            cv2.writeOpticalFlow(str(out / f"{name.stem}.flo"), flow.calc(before, grey, None))
        before = grey


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="1600x1200", help="WIDTHxHEIGHT")
    parser.add_argument("--frames", type=int, default=16)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--srflow", default=str(ROOT / "target/release/srflow"))
    args = history.parse(parser)
    width, height = map(int, args.size.split("x"))
    cv2.setNumThreads(args.threads)
    ours, theirs = [], []
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        (folder / "frames").mkdir()
        (folder / "theirs").mkdir()
        names = [folder / "frames" / f"{number:04}.png" for number in range(args.frames)]
        random = np.random.default_rng(1)
        both = frames(width, height, None)
        for number, name in enumerate(names):
            noise = random.normal(0, 2, (height, width, 3))
            cv2.imwrite(str(name), np.clip(both[number % 2] + noise, 0, 255).astype(np.uint8))
        for _ in range(args.repeats):
            start = time.perf_counter()
            loop(names, folder / "theirs")
            theirs.append(time.perf_counter() - start)
            command = [args.srflow, "flow", "--method", "farneback", folder / "frames", "-o", folder / "ours"]
            command += ["--format", "flo", "--force", "--threads", args.threads]
            start = time.perf_counter()
            subprocess.run([str(part) for part in command], check=True, capture_output=True)
            ours.append(time.perf_counter() - start)
    us, them = (statistics.median(seconds) / (args.frames - 1) for seconds in (ours, theirs))
    print(f"{width}x{height}, {args.threads} threads, OpenCV {cv2.__version__}, median of {args.repeats}")
    print(f"srflow {us:.3f} s a pair   OpenCV {them:.3f} s   {them / us:.2f} times")
    if args.record:
        note = f"s a pair; farneback over PNGs of {args.size}; OpenCV {cv2.__version__}"
        history.append("classical", us, them, note)


if __name__ == "__main__":
    main()
