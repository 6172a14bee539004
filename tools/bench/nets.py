#!/usr/bin/env python3
"""Times srflow's networks against ptlflow's (PyTorch), in turn, on the same weights, frames, iterations and threads.

    pip install ptlflow==0.4.2
    cargo build --release -p srflow-nets --example timing
    python3 tools/bench/nets.py [--networks raft gma skflow] [--sizes 800x512] [--iterations 32] [--threads 2] [--repeats 3]
                                [--ours f32 bf16] [--theirs f32 bf16 compiled compiled-bf16]

PyTorch may run as it is (f32), under autocast (bf16), and with the block that is iterated compiled by `torch.compile`, which needs a
C++ compiler. Weights are random, as ptlflow makes a new model (a fixed seed), saved and loaded by both. The second frame is the first,
a made texture, moved by a smooth flow of a few pixels. Each side runs in a process of its own; times are those of
estimating, model and frames already in memory, the median of the repeats (each process runs all of its own, and what is compiled
once more at first); memory is the most that the process ever held. Prints a Markdown table for each network and size: seconds and GB,
how many times as fast ours is as the fastest of theirs, and mean and largest distance in pixels from their f32 flow, and of our bf16
from our f32, beside the mean length of the flow.
"""

import argparse
import os
import platform
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import history
import numpy as np
from weights import SEED, new_model, random_state

ROOT = Path(__file__).resolve().parents[2]
OUT_OF_MEMORY = 3  # exit status
# Names of the attribute that holds a model's iterations.
ITERATIONS = {"dpflow": "iters_per_level", "memflow": "decoder_depth", "unimatch_sc2_ref6": "num_reg_refine"}
# Iterations in each level of models that take a list, by default; others are in proportion, as srflow has them.
OF_LEVELS = {"ccmr": (8, 10, 15), "ccmr_p": (8, 10, 10, 10)}


def texture(height, width, y, x):
    """Waves of several lengths at real positions, [3, height, width] in 0..1."""
    random = np.random.default_rng(SEED)
    image = np.zeros((3, height, width))
    for length in (7, 12, 21, 45, 110):
        for channel in range(3):
            for _ in range(3):
                angle, phase = random.uniform(0, 2 * np.pi, 2)
                image[channel] += np.sin(2 * np.pi * (x * np.cos(angle) + y * np.sin(angle)) / length + phase)
    return (0.5 + image / 30).clip(0, 1)


def frames(height, width):
    """Both frames, [2, 3, height, width] RGB in 0..1."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    u = 3 * np.sin(x / 170) + 2 * np.cos(y / 130)
    v = 2 * np.cos(x / 210) - 3 * np.sin(y / 190)
    return np.stack([texture(height, width, y, x), texture(height, width, y - v, x - u)]).astype("<f4")


def run(command, environment):
    """The lines that a process printed, and the most memory it held in GB; no lines if it ran out of memory."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    lines = process.stdout.read().splitlines()
    _, status, usage = os.wait4(process.pid, 0)
    if os.waitstatus_to_exitcode(status) == OUT_OF_MEMORY:
        return [], usage.ru_maxrss * 1024 / 1e9
    if status != 0:
        sys.exit(f"failed: {' '.join(map(str, command))}")
    return lines, usage.ru_maxrss * 1024 / 1e9


def reference(mode, network, iterations, threads, repeats, weights, pixels, out, height, width):
    """What the process of ptlflow's side does."""
    import torch


    torch.set_num_threads(threads)
    model = new_model(network).eval()
    model.load_state_dict(torch.load(weights, weights_only=True))
    if iterations > 0:
        if levels := OF_LEVELS.get(network):
            iterations = [-(-own * iterations // levels[-1]) for own in levels]
        setattr(model, ITERATIONS.get(network, "iters"), iterations)
    # An error of its own, before the system stops whatever it chooses.
    limit = int(0.85 * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    if mode.startswith("compiled"):
        model.update_block = torch.compile(model.update_block)
        repeats += 1
    pair = np.fromfile(pixels, "<f4").reshape(1, 2, 3, height, width)[:, :, ::-1].copy()  # ptlflow takes BGR
    images = torch.from_numpy(pair)
    for _ in range(repeats):
        start = time.perf_counter()
        try:
            with torch.no_grad(), torch.autocast("cpu", torch.bfloat16, enabled=mode.endswith("bf16")):
                flow = model({"images": images})["flows"]
        except (MemoryError, RuntimeError) as error:
            if "memory" not in str(error) and not isinstance(error, MemoryError):
                raise
            sys.exit(OUT_OF_MEMORY)
        print(time.perf_counter() - start)
    flow.float().numpy().astype("<f4").tofile(out)


def save_weights(network, path):
    import torch

    torch.save(random_state(network), path)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--networks", nargs="+", default=["raft", "gma", "skflow"], help="ptlflow's names")
    parser.add_argument("--sizes", nargs="+", default=["800x512"], help="WIDTHxHEIGHT")
    parser.add_argument("--iterations", type=int, default=0, help="0: as many as ptlflow's default for each network")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--ours", nargs="+", default=["f32"], choices=["f32", "bf16"])
    parser.add_argument("--theirs", nargs="*", default=["f32"], choices=["f32", "bf16", "compiled", "compiled-bf16"])
    parser.add_argument("--timing", default=str(ROOT / "target/release/examples/timing"), help="our side")
    parser.add_argument("--side", nargs=10, help=argparse.SUPPRESS)
    parser.add_argument("--weights", nargs=2, help=argparse.SUPPRESS)
    args = history.parse(parser)
    if args.side:
        mode, network, iterations, threads, repeats, weights, pixels, out, height, width = args.side
        reference(
            mode, network, int(iterations), int(threads), int(repeats), weights, pixels, out, int(height), int(width)
        )
        return
    if args.weights:
        save_weights(*args.weights)
        return

    environment = dict(os.environ, RAYON_NUM_THREADS=str(args.threads), OMP_NUM_THREADS=str(args.threads))
    print(f"{platform.machine()}, {args.threads} threads, {args.iterations or 'default'} iterations, median of {args.repeats}")
    with tempfile.TemporaryDirectory() as folder:
        weights, pixels, out = (str(Path(folder) / name) for name in ("weights.pth", "frames", "flow"))
        for network in args.networks:
            run([sys.executable, __file__, "--weights", network, weights], environment)
            for size in args.sizes:
                width, height = map(int, size.split("x"))
                frames(height, width).tofile(pixels)
                common = [str(args.repeats), weights, pixels, out]

                def flow():
                    return np.fromfile(out, "<f4").reshape(2, height, width)

                ours, theirs = {}, {}
                for precision in args.ours:
                    name = network.replace("_", "-") + ("@bf16" if precision == "bf16" else "")
                    lines, memory = run([args.timing, name, f"{height}x{width}", str(args.iterations), *common], environment)
                    seconds = statistics.median(float(line.split()[0]) for line in lines if line.endswith(" s"))
                    ours[precision] = seconds, memory, flow()
                for mode in args.theirs:
                    side = [mode, network, str(args.iterations), str(args.threads), *common, str(height), str(width)]
                    lines, memory = run([sys.executable, __file__, "--side", *side], environment)
                    if lines:
                        theirs[mode] = statistics.median(map(float, lines[-args.repeats :])), memory, flow()
                    else:
                        theirs[mode] = None, memory, None
                table(network, size, ours, theirs)
                if args.record:
                    best, mode = min(((result[0], mode) for mode, result in theirs.items() if result[0]), default=(None, None))
                    peer = f"; PyTorch {mode}" if mode else ""
                    for precision, (seconds, memory, _) in ours.items():
                        note = f"s; {network} at {size}; srflow {precision} {memory:.2f} GB{peer}"
                        history.append("networks", seconds, best, note)


def table(network, size, ours, theirs):
    """Prints the rows of one network and size."""
    best = min((seconds for seconds, _, _ in theirs.values() if seconds), default=None)
    truth = next((flow for _, _, flow in theirs.values() if flow is not None), None)
    print(f"\n{network}, {size}\n")
    print("| | seconds | GB | theirs at best / this | distance to their f32, px | largest | to our f32 | largest | mean flow |")
    print("|---|---|---|---|---|---|---|---|---|")

    def distance(flow, other):
        if flow is None or other is None or flow is other:
            return " | "
        far = np.linalg.norm(flow - other, axis=0)
        return f"{far.mean():.1e} | {far.max():.1e}"

    own = ours.get("f32", (None, None, None))[2]
    for side, results in (("srflow", ours), ("PyTorch", theirs)):
        for mode, (seconds, memory, flow) in results.items():
            if seconds is None:
                print(f"| {side} {mode} | out of memory | over {memory:.0f} | | | | | | |", flush=True)
                continue
            ratio = f"{best / seconds:.2f}" if best and side == "srflow" else ""
            near = distance(flow, own) if side == "srflow" else " | "
            print(
                f"| {side} {mode} | {seconds:.2f} | {memory:.2f} | {ratio} | {distance(flow, truth)} | {near} | "
                f"{np.linalg.norm(flow, axis=0).mean():.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
