#!/usr/bin/env python3
"""Coefficients of the polynomial for 2^f on [-0.5, 0.5] in crates/splat/src/simd/mod.rs.

Remez exchange on the relative error of c0 + c1 f + ... + c5 f^5. Needs mpmath: `pip install mpmath`.
Prints the coefficients rounded to f32, c0 set to 1 so that 2^0 is exact, and the largest relative error with those.
"""
import struct

from mpmath import lu_solve, matrix, mp, mpf

mp.dps = 40
DEGREE = 5
SIDE = mpf(1) / 2
GRID = [-SIDE + 2 * SIDE * k / 4000 for k in range(4001)]


def error(c, f):
    return sum(c[i] * f**i for i in range(DEGREE + 1)) / mpf(2) ** f - 1


def extrema(c):
    """The point of largest |error| between each two sign changes."""
    points, best, sign = [], None, None
    for f in GRID:
        e = error(c, f)
        if sign is not None and (e > 0) != sign:
            points.append(best[1])
            best = None
        sign = e > 0
        best = max(best or (mpf(-1), f), (abs(e), f))
    return points + [best[1]]


points = [SIDE * mp.cos(mp.pi * k / (DEGREE + 1)) for k in range(DEGREE + 2)]
for _ in range(10):
    rows, right = matrix(DEGREE + 2, DEGREE + 2), matrix(DEGREE + 2, 1)
    for row, f in enumerate(points):
        for i in range(DEGREE + 1):
            rows[row, i] = f**i / mpf(2) ** f
        rows[row, DEGREE + 1] = (-1) ** row
        right[row] = 1
    c = lu_solve(rows, right)[: DEGREE + 1]
    points = extrema(c)
    assert len(points) == DEGREE + 2, "the exchange lost its alternation"

rounded = [mpf(struct.unpack("f", struct.pack("f", float(x)))[0]) for x in c]
rounded[0] = mpf(1)
for i, x in enumerate(rounded):
    print(f"c{i} = {float(x):.9e}")
print(f"largest relative error: exact {float(max(abs(error(c, f)) for f in GRID)):.2e},", end=" ")
print(f"rounded {float(max(abs(error(rounded, f)) for f in GRID)):.2e}")
