"""Peak memory of `srflow flow` with networks, by size of the frames.

    cargo build --release
    python3 tools/bench/weights.py weights
    python3 tools/bench/memory.py raft=weights/raft.pth skflow=weights/skflow.pth

Prints the peak of the process at each size in MB, without that of a frame of 128x128, and a straight line that none of them
passes once the attention's kept weights are off: `Architecture::memory_need` is such a line and these weights. One
iteration: more take no more. The weights may be random, the frames are noise. Needs numpy and pillow.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
SIZES = [
    *[(320, 256), (512, 384), (640, 480), (800, 512), (1024, 768), (1280, 720)],
    *[(1280, 960), (1600, 1200), (2048, 1536), (3840, 2160)],
]
# All pixels of the coarse flow attend to each other; of the weights this much is kept.
ATTENDING = ["gma", "skflow"]
MOST_WEIGHTS = 800 << 20


def peak_bytes(command):
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status != 0:
        sys.exit(f"{' '.join(map(str, command))}: ended with {status}")
    return usage.ru_maxrss * 1024


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("method", nargs="+", help="NETWORK=WEIGHTS")
    parser.add_argument("--srflow", default=ROOT / "target/release/srflow")
    parser.add_argument("--sizes", nargs="+", default=["x".join(map(str, size)) for size in SIZES])
    parser.add_argument("--iterations", default="1", help="0 for networks without")
    parser.add_argument("--tile", help="as srflow flow takes it")
    args = parser.parse_args()
    sizes = [tuple(map(int, size.split("x"))) for size in args.sizes]
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        random = np.random.default_rng(1)

        def peak(method, size):
            frames = [folder / f"{size[0]}x{size[1]}-{number}.png" for number in range(2)]
            for frame in frames:
                if not frame.exists():
                    noise = random.integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)
                    Image.fromarray(noise).save(frame, compress_level=0)
            command = [args.srflow, "flow", "--method", method, "--force", "-o", folder / "flow.flo"]
            command += [] if args.iterations == "0" else ["--iters", args.iterations]
            tile = ["--tile", args.tile] if args.tile else []
            return peak_bytes([*command, *tile, *frames])

        for method in args.method:
            base = peak(method, (128, 128))
            found = [(width * height, peak(method, (width, height)) - base) for width, height in sizes]
            for (width, height), (pixels, more) in zip(sizes, found):
                print(f"{method.split('=')[0]} {width}x{height}: {more / 1e6:.0f} MB, {more / pixels:.0f} B/pixel")
            if method.split("=")[0] in ATTENDING:
                found = [(pixels, more - min(4 * (pixels // 64) ** 2, MOST_WEIGHTS)) for pixels, more in found]
            if len(found) > 1:
                slope = max(0.0, (found[-1][1] - found[0][1]) / (found[-1][0] - found[0][0]))
                fixed = max(more - slope * pixels for pixels, more in found)
                print(f"{method.split('=')[0]}: {fixed / 1e6:.0f} MB and {slope:.0f} B/pixel; {base / 1e6:.0f} MB at 128x128")


if __name__ == "__main__":
    main()
