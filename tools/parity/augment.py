#!/usr/bin/env python3
"""Golden data of srflow-train's augmentation: torchvision's changes of colour and OpenCV's resize.

Writes crates/train/tests/data/augment/. Made with torchvision 0.26.0 over Pillow 13.0.0, and OpenCV 4.13.0:

    tools/parity/augment.py

Pictures are PNG, flows .npy; the names say what was done.
"""

from pathlib import Path

import cv2
import numpy as np
from PIL import Image
from torchvision.transforms import functional as F

DATA = Path(__file__).resolve().parents[2] / "crates/train/tests/data/augment"
CHANGES = {
    "brightness": F.adjust_brightness,
    "contrast": F.adjust_contrast,
    "saturation": F.adjust_saturation,
    "hue": F.adjust_hue,
}
AMOUNTS = [
    *[("brightness", 0.62), ("brightness", 1.37)],
    *[("contrast", 0.61), ("contrast", 1.39)],
    *[("saturation", 0.63), ("saturation", 1.38)],
    *[("hue", 0.13), ("hue", -0.159), ("hue", 0.0)],
]
CHAIN = [("contrast", 1.21), ("hue", -0.07), ("brightness", 0.83), ("saturation", 1.31)]
SCALES = [(1.37, 0.81), (0.55, 2.3)]


def picture(random, height, width):
    """Three kinds of pixels: any colour, one near grey, one whose largest or smallest channels are equal."""
    pixels = random.integers(0, 256, (height, width, 3))
    grey = random.integers(0, 256, (height, width, 1)) + random.integers(-4, 5, (height, width, 3))
    twins = pixels[:, :, [0, 0, 1]][:, :, random.permutation(3)]
    kind = random.integers(0, 3, (height, width, 1))
    return np.clip(np.choose(kind, [pixels, grey, twins]), 0, 255).astype(np.uint8)


def main():
    DATA.mkdir(parents=True, exist_ok=True)
    random = np.random.default_rng(7)
    source = picture(random, 48, 64)
    Image.fromarray(source).save(DATA / "picture.png")
    for name, amount in AMOUNTS:
        CHANGES[name](Image.fromarray(source), amount).save(DATA / f"{name}_{amount}.png")
    chained = Image.fromarray(source)
    for name, amount in CHAIN:
        chained = CHANGES[name](chained, amount)
    chained.save(DATA / "chain.png")

    flow = random.normal(0, 5, (48, 64, 2)).astype(np.float32)
    np.save(DATA / "flow.npy", flow)
    for fx, fy in SCALES:
        resize = lambda image: cv2.resize(image, None, fx=fx, fy=fy, interpolation=cv2.INTER_LINEAR)
        Image.fromarray(resize(source)).save(DATA / f"scaled_{fx}_{fy}.png")
        np.save(DATA / f"flow_{fx}_{fy}.npy", (resize(flow) * [fx, fy]).astype(np.float32))


if __name__ == "__main__":
    main()
