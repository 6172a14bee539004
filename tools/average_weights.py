"""Averages two files of weights of the same network: python tools/average_weights.py A B SHARE_OF_B OUT (safetensors, numpy)."""

import sys

import numpy as np
from safetensors import safe_open
from safetensors.numpy import save_file

first, second, share, out = sys.argv[1:]
share = np.float32(share)
with safe_open(first, "numpy") as a, safe_open(second, "numpy") as b:
    assert set(a.keys()) == set(b.keys()), "weights of two different networks"
    # In the precision of the second file.
    averaged = {
        name: ((1 - share) * a.get_tensor(name).astype(np.float32) + share * b.get_tensor(name)).astype(b.get_tensor(name).dtype)
        for name in b.keys()
    }
    save_file(averaged, out, b.metadata())
