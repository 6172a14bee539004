#!/usr/bin/env python3
"""Times a training step of srflow against ptlflow's networks in PyTorch: same crop, batch, iterations, loss and threads.

    pip install ptlflow==0.4.2
    cargo build --release
    python3 tools/bench/train_step.py [--network skflow] [--crop 256x192] [--batch 1] [--iterations 6] [--threads 2]
                                     [--theirs bf16] [--set training.precision=bf16]

PyTorch's step is the forward pass in training mode, SKFlow's sequence loss, the backward pass, the clipping of gradients and
AdamW, on random frames that are in memory. srflow's is the same and everything around it, as its log tells: reading and
augmenting pairs on threads of their own, and the log itself. Prints the median seconds of a step, the peak memory of
both processes, and the ratio.
"""

import argparse
import json
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import history
import numpy as np

ROOT = Path(__file__).resolve().parents[2]


def theirs(args, width, height):
    import ptlflow
    import torch

    torch.set_num_threads(args.threads)
    torch.manual_seed(1)
    model = ptlflow.get_model(args.network.replace("-", "_")).train()
    model.iters = args.iterations
    if args.theirs.startswith("compiled"):
        model.update_block = torch.compile(model.update_block)
    autocast = torch.autocast("cpu", torch.bfloat16, enabled=args.theirs.endswith("bf16"))
    optimizer = torch.optim.AdamW(model.parameters(), lr=1e-4, weight_decay=1e-4, eps=1e-8)
    images = torch.rand(args.batch, 2, 3, height, width)
    truth = 4 * torch.rand(args.batch, 2, height, width) - 2
    seconds = []
    for _ in range(args.steps):
        start = time.perf_counter()
        optimizer.zero_grad()
        with autocast:
            predictions = [flow.float() for flow in model({"images": images})["flow_preds"]]
        last = len(predictions) - 1
        loss = sum(0.8 ** (last - i) * (flow - truth).abs().mean() for i, flow in enumerate(predictions))
        loss.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimizer.step()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds[1:]), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def ours(args):
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        data = folder / "data"
        data.mkdir()
        random = np.random.default_rng(7)
        size = 400
        for i in range(2):
            for name in ("img1", "img2"):
                pixels = random.integers(0, 256, (size, size, 3), dtype=np.uint8).tobytes()
                (data / f"{i}_{name}.ppm").write_bytes(b"P6\n%d %d\n255\n" % (size, size) + pixels)
            flow = (4 * random.random((size, size, 2)) - 2).astype("<f4").tobytes()
            (data / f"{i}_flow.flo").write_bytes(b"PIEH" + np.int32([size, size]).tobytes() + flow)
        run = folder / "run"
        command = [args.srflow, "train", "--data", f"folder:{data}", "--out", run, "--network", args.network]
        command += ["--crop", args.crop, "--batch", args.batch, "--iterations", args.iterations]
        command += ["--steps", args.steps, "--threads", args.threads, "--json", "--set", "checkpoints.every=1000000"]
        for given in args.set:
            command += ["--set", given]
        out = subprocess.run([str(part) for part in command], check=True, capture_output=True, text=True).stdout
        records = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
        seconds = [record["seconds"] for record in records if record["kind"] == "step"]
        return statistics.median(seconds[1:]), json.loads(out)["peak_memory_bytes"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--network", default="skflow")
    parser.add_argument("--crop", default="256x192", help="WIDTHxHEIGHT")
    parser.add_argument("--batch", type=int, default=1)
    parser.add_argument("--iterations", type=int, default=6)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--steps", type=int, default=6, help="the first is not counted")
    parser.add_argument(
        "--theirs", default="f32", choices=["f32", "bf16", "compiled", "compiled-bf16"],
        help="autocast to bf16, the block that is iterated compiled by torch.compile, or both",
    )
    parser.add_argument("--set", action="append", default=[], help="passed on to srflow train")
    parser.add_argument("--only", choices=["srflow", "torch"])
    parser.add_argument("--srflow", default=str(ROOT / "target/release/srflow"))
    args = history.parse(parser)
    width, height = map(int, args.crop.split("x"))
    print(f"{args.network}, {args.crop}, batch {args.batch}, {args.iterations} iterations, {args.threads} threads")
    results = {}
    if args.only != "torch":
        results["srflow"] = ours(args)
    if args.only != "srflow":
        results["torch"] = theirs(args, width, height)
    for name, (seconds, peak) in results.items():
        print(f"{name:8} {seconds:8.3f} s/step  {peak / 1e9:6.2f} GB peak")
    if len(results) == 2:
        print(f"ratio    {results['torch'][0] / results['srflow'][0]:8.2f}")
        if args.record:
            (us, our_peak), (them, their_peak) = results["srflow"], results["torch"]
            note = f"s a step of {args.network}; {our_peak / 1e9:.2f} and {their_peak / 1e9:.2f} GB; PyTorch {args.theirs}"
            history.append("training", us, them, note)
    sys.stdout.flush()


main()
