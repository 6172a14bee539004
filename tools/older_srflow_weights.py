"""Weights of the network srflow of version 0.1.0 as those of the network of today: a start to train from.

    pip install numpy safetensors
    python tools/older_srflow_weights.py OLD NEW

Corrections no longer hand a state to the next one, so the first layer loses the inputs that read it. Upsampling begins with bilinear
interpolation: its learned weights repeat in each cell, and drew a lattice into the flow.
"""

import sys

import numpy as np
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

STATE = 32
NOT_BILINEAR = 1 / 128


def bilinear_scores():
    """As `bilinear_mask` in crates/nets/src/srflow.rs: for each of 9 neighbours, of the 4 pixels of a cell."""
    along = np.array([[0.25, 0.75, NOT_BILINEAR], [NOT_BILINEAR, 0.75, 0.25]])
    return np.log([along[pixel // 2, cell // 3] * along[pixel % 2, cell % 3] for cell in range(9) for pixel in range(4)])


def main(old, new):
    with safe_open(old, "numpy") as file:
        metadata = file.metadata()
    tensors = load_file(old)
    entering = tensors["enter.weight"]
    if entering.shape[1] != 78:
        raise SystemExit(f"{old}: expected a first layer of 78 inputs, as in srflow 0.1.0, found {entering.shape[1]}")
    tensors["enter.weight"] = np.ascontiguousarray(entering[:, :-STATE])
    tensors["mask.weight"] = np.zeros_like(tensors["mask.weight"])
    tensors["mask.bias"] = bilinear_scores().astype(tensors["mask.bias"].dtype)
    save_file(tensors, new, metadata)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        raise SystemExit(__doc__)
    main(*sys.argv[1:])
