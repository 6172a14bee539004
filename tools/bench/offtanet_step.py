#!/usr/bin/env python3
"""Times a training step of Off-TANet at batch 64: srflow and PyTorch in turn, on the same cores.

    pip install torch==2.11.0
    cargo build --release --workspace --example offtanet_step
    python3 tools/bench/offtanet_step.py [--cores 2] [--steps 20] [--rounds 3]

Prints the median seconds of a step of
    one fold         the kernels share all cores, as PyTorch does by itself
    a fold per core  as `srflow mer run` trains: each core has a network of its own, and CORES steps are done at a time
and for both the steps per second of the whole machine.
"""

import argparse
import multiprocessing
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

import history

ROOT = Path(__file__).resolve().parents[2]


def pytorch(threads, steps):
    """Median seconds of a step of one network on `threads` threads."""
    sys.path.insert(0, str(ROOT / "tools/parity"))
    import torch
    from mer_networks import OffTaNet
    from torch.nn import functional as F

    torch.set_num_threads(threads)
    torch.manual_seed(1)
    network = OffTaNet()
    optimizer = torch.optim.Adam(network.parameters(), lr=6.5e-4)
    inputs, labels = torch.rand(64, 3, 112, 112) * 2 - 1, torch.arange(64) % 3
    seconds = []
    for _ in range(steps + 1):
        start = time.perf_counter()
        loss = F.cross_entropy(network(inputs), labels)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        loss.item()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds[1:])


def pytorch_folds(cores, steps):
    """The same for `cores` networks at a time, each in a process of one thread."""
    with multiprocessing.get_context("spawn").Pool(cores) as pool:
        return statistics.median(pool.starmap(pytorch, [(1, steps)] * cores))


def srflow(program, folds, cores, steps):
    environment = {**os.environ, "RAYON_NUM_THREADS": str(cores)}
    out = subprocess.run([program, str(folds), str(steps)], env=environment, capture_output=True, text=True, check=True)
    return float(out.stdout)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--program", default=str(ROOT / "target/release/examples/offtanet_step"))
    args = history.parse(parser)
    for name, folds, ours_of, theirs_of in [
        ("one fold", 1, lambda: srflow(args.program, 0, args.cores, args.steps), lambda: pytorch(args.cores, args.steps)),
        (
            "a fold per core",
            args.cores,
            lambda: srflow(args.program, args.cores, args.cores, args.steps),
            lambda: pytorch_folds(args.cores, args.steps),
        ),
    ]:
        ours, theirs = [], []
        for _ in range(args.rounds):
            ours.append(ours_of())
            theirs.append(theirs_of())
        ours, theirs = statistics.median(ours), statistics.median(theirs)
        print(
            f"{name}: srflow {ours:.3f} s ({folds / ours:.1f} steps/s), PyTorch {theirs:.3f} s "
            f"({folds / theirs:.1f} steps/s), PyTorch / srflow {theirs / ours:.2f}"
        )
        if args.record:
            history.append("recognition", ours, theirs, f"s a step of Off-TANet at batch 64; {name}")


if __name__ == "__main__":
    main()
