"""Photographs warped by known flows, as a plain folder of pairs for `srflow eval --dataset folder:DIR`.

    pip install numpy opencv-python-headless
    python tools/warped_photographs.py DIR PHOTOGRAPH...

Frame 2 is the photograph P at half of its size or less, frame 1 is P sampled at the end points of the flow and reduced alike: frame 1 at x
is P at x + flow(x), so that the flow is exact. Neither frame is sharper than the other, since both are means of blocks of a larger
picture. The flow is an affine motion, as of a head that turns, and bumps, as of muscles below skin; both have sizes drawn evenly on a
logarithmic scale. Each frame has noise of its own.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np

PAIRS = 6
LONGEST_SIDE = 640
BLOCK = 2
NOISE_LEVELS = 1.5
# Cut off at each side, in pixels: there, frame 1 would show what is beyond the photograph.
MARGIN = 12
# Frames of a photograph of this size have 32 pixels a side.
SMALLEST_SIDE = BLOCK * (2 * MARGIN + 32)
DRIFT_PX = (0.05, 4.0)
BUMPS_PX = (0.1, 3.0)


def smooth_flow(rng, height, width):
    """height x width x 2, pixels."""
    y, x = np.mgrid[:height, :width].astype(np.float64)
    side = max(height, width)
    px, py = (x - width / 2) / side, (y - height / 2) / side
    log_uniform = lambda limits: np.exp(rng.uniform(*np.log(limits)))
    affine = rng.normal(size=(2, 3))
    drift = np.stack([row[0] + row[1] * px + row[2] * py for row in affine], -1)
    flow = drift * (log_uniform(DRIFT_PX) / np.hypot(*affine[:, 0]))
    size = log_uniform(BUMPS_PX)
    for _ in range(rng.integers(4, 12)):
        at, sigma = rng.uniform(0.1, 0.9, 2) * (width, height), rng.uniform(0.03, 0.12) * side
        angle = rng.uniform(0, 2 * np.pi)
        bump = np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / (2 * sigma**2))
        flow += size * rng.uniform(0.3, 1.0) * bump[..., None] * (np.cos(angle), np.sin(angle))
    return flow


def pair(rng, photograph):
    """Frames as uint8, and the flow of the reduced frames."""
    height, width = (side // BLOCK for side in photograph.shape[:2])
    large = photograph[: height * BLOCK, : width * BLOCK]
    flow = smooth_flow(rng, height, width)
    y, x = np.mgrid[: height * BLOCK, : width * BLOCK].astype(np.float32)
    # Of the centres of the large picture's pixels, in pixels of the reduced frame.
    at = (x + 0.5) / BLOCK - 0.5, (y + 0.5) / BLOCK - 0.5
    spread = cv2.remap(flow.astype(np.float32), *at, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE) * BLOCK
    first = cv2.remap(large, x + spread[..., 0], y + spread[..., 1], cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REFLECT_101)
    frames = []
    for frame in first, large:
        reduced = cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA)
        frames.append(np.clip(np.rint(reduced + rng.normal(0, NOISE_LEVELS, reduced.shape)), 0, 255).astype(np.uint8))
    inside = slice(MARGIN, -MARGIN)
    return *(frame[inside, inside] for frame in frames), flow[inside, inside].astype(np.float32)


def write_pair(folder, name, frames, flow):
    """A pair of a plain folder."""
    for number, frame in enumerate(frames, 1):
        cv2.imwrite(str(folder / f"{name}_img{number}.png"), frame)
    with open(folder / f"{name}_flow.flo", "wb") as file:
        file.write(b"PIEH" + np.array(flow.shape[1::-1], "<i4").tobytes() + flow.astype("<f4").tobytes())


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("photographs", type=Path, nargs="+")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    args.out.mkdir(parents=True)
    for path in args.photographs:
        photograph = cv2.imread(str(path))
        if photograph is None:
            raise SystemExit(f"{path}: not a picture")
        scale = min(1.0, LONGEST_SIDE * BLOCK / max(photograph.shape[:2]))
        photograph = cv2.resize(photograph, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA).astype(np.float32)
        if min(photograph.shape[:2]) < SMALLEST_SIDE:
            raise SystemExit(f"{path}: expected sides of at least {SMALLEST_SIDE} pixels, found {photograph.shape[1]}x{photograph.shape[0]}")
        for number in range(PAIRS):
            rng = np.random.default_rng([args.seed, number, *path.name.encode()])
            first, second, flow = pair(rng, photograph)
            write_pair(args.out, f"{path.resolve().parent.name}-{path.stem}-{number}", [first, second], flow)


if __name__ == "__main__":
    main()
