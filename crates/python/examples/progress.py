"""Renders a small dataset and trains a network on it, each with a bar of tqdm. Ctrl-C stops cleanly: run it again to continue.

python progress.py FOLDER
"""

import pathlib
import sys

from tqdm import tqdm

import srflow


def shown_by(bar):
    """A callback that moves the bar."""

    def show(progress):
        bar.total = progress["total"]
        bar.update(progress["done"] - bar.n)
        if progress.get("event") == "step":
            bar.set_postfix(loss=f"{progress['loss']:.3f}", epe=f"{progress['epe']:.2f} px")

    return show


def main(folder, scenes=4, frames=4, steps=20):
    data, run = pathlib.Path(folder, "data"), pathlib.Path(folder, "run")
    with tqdm(desc="rendering", unit="pair") as bar:
        srflow.render(data, scenes=scenes, frames=frames, size="160x224", callback=shown_by(bar))
    begun = any((run / "checkpoints").glob("step-*"))
    arguments = (
        {"resume": run}
        if begun
        else {"config": "cpu-small", "out": run, "data": f"srflow:{data}", "steps": steps, "crop": "128x128", "batch": 2}
    )
    with tqdm(desc="training", unit="step") as bar:
        result = srflow.train(**arguments, callback=shown_by(bar))
    print(f"{result['steps']} steps, weights in {result['weights']}")
    return result


if __name__ == "__main__":
    main(*sys.argv[1:])
