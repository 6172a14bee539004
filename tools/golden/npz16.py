"""Makes crates/files/tests/data/numpy.npz16: a flow that NumPy wrote in the npz16 format, of a formula the test knows.

Needs numpy. Also reads a file that srflow wrote, when one is given, and prints its flow's range.
"""

import pathlib
import sys

import numpy as np

y, x = np.mgrid[0:5, 0:7]
flow = np.stack([x * x * 3.25 - y * 40.5, -0.00390625 * x * y])  # (2, H, W)
flow[:, 2, 3] = np.nan
flow[0, 4, 6] = -300.0
step = 2.0**-6  # the greatest component is 300 px: 300 / 32767 is less than 2**-6
q = np.where(np.isnan(flow), -32768, np.round(np.nan_to_num(flow) / step)).astype(np.int16)
d = np.diff(np.diff(q, axis=1, prepend=np.int16(0)), axis=2, prepend=np.int16(0))
low = d.astype(np.int8)
high = ((d.astype(np.int32) - low) // 256).astype(np.int8)
folder = pathlib.Path(__file__).parents[2] / "crates/files/tests/data"
with open(folder / "numpy.npz16", "wb") as file:
    np.savez_compressed(file, step=np.float32(step), low=low, high=high)


def read(path):
    z = np.load(path)
    q = (z["high"] * np.int16(256) + z["low"]).cumsum(1, dtype=np.int16).cumsum(2, dtype=np.int16)
    return np.where(q == -32768, np.float32(np.nan), q * z["step"]).transpose(1, 2, 0)


assert np.nanmax(np.abs(read(folder / "numpy.npz16") - flow.transpose(1, 2, 0))) <= step / 2
for path in sys.argv[1:]:
    flow = read(path)
    print(path, flow.shape, flow.dtype, np.nanmin(flow), np.nanmax(flow))
