"""docs/explanation/networks.md: networks with trained weights on real frames, against PyTorch.

    pip install ptlflow==0.4.2 opencv-python-headless
    python tools/parity/trained_table.py OUT --weights raft-small=FILE unimatch-sc2=FILE --pairs NAME=FOLDER...

Each FOLDER holds pairs as NAME_img1.png, NAME_img2.png and NAME_flow.flo, or NAME_flow.png as of KITTI; pairs of photographs come from
tools/warped_photographs.py. PyTorch is ptlflow's network with the same weights, in float32 and with autocast to bfloat16. Prints a table
for each set of pairs: the mean end-point error of each, and the mean distance between them, in pixels. Flows stay in OUT, and are
computed again only where they are missing.
"""

import argparse
import subprocess
from pathlib import Path

import cv2
import numpy as np
from trained import NETWORKS, flow, model

def truth(frame1):
    """The flow of a pair, height x width x 2, and where it is known."""
    flo = frame1.with_name(frame1.name.replace("_img1.png", "_flow.flo"))
    if flo.exists():
        data = flo.read_bytes()
        width, height = np.frombuffer(data[4:12], "<i4")
        flow = np.frombuffer(data[12:], "<f4").reshape(height, width, 2)
        return flow, (np.abs(flow) < 1e9).all(-1)
    stored = cv2.imread(str(flo.with_suffix(".png")), cv2.IMREAD_UNCHANGED).astype(np.float32)
    return (stored[..., :0:-1] - 32768) / 64, stored[..., 0] > 0


def of_srflow(network, weights, precision, pair, out):
    iterations = NETWORKS[network][2]
    command = ["srflow", "flow", *map(str, pair), "--method", f"{network}={weights}", "--precision", precision, "-o", out]
    subprocess.run(command + ["--iters", str(iterations)] * (iterations > 1), check=True, stdout=subprocess.DEVNULL)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--weights", nargs="+", required=True)
    parser.add_argument("--pairs", nargs="+", required=True)
    arguments = parser.parse_args()
    named = lambda options: [option.split("=", 1) for option in options]
    print("| pairs | network | srflow, EPE | bf16 | PyTorch, EPE | autocast | srflow - PyTorch | bf16 - f32 | autocast - f32 |")
    print("|---|---|--:|--:|--:|--:|--:|--:|--:|")
    for network, weights in named(arguments.weights):
        found = model(network, weights)
        for name, folder in named(arguments.pairs):
            rows = []
            for frame1 in sorted(Path(folder).glob("*_img1.png")):
                pair = frame1, frame1.with_name(frame1.name.replace("_img1", "_img2"))
                flows = []
                for program in "srflow", "pytorch":
                    for precision in "f32", "bf16":
                        out = arguments.out / network / name / f"{frame1.name.removesuffix('_img1.png')}-{program}-{precision}.npy"
                        out.parent.mkdir(parents=True, exist_ok=True)
                        if not out.exists() and program == "srflow":
                            of_srflow(network, weights, precision, pair, out)
                        elif not out.exists():
                            np.save(out, flow(found, [cv2.imread(str(frame)) for frame in pair], precision))
                        flows.append(np.load(out))
                true, known = truth(frame1)
                errors = [np.hypot(*(estimate - true).transpose(2, 0, 1))[known].mean() for estimate in flows]
                ours, ours16, theirs, theirs16 = flows
                apart = [np.hypot(*(a - b).transpose(2, 0, 1)).mean() for a, b in ((ours, theirs), (ours16, ours), (theirs16, theirs))]
                rows.append(errors + apart)
            mean = np.mean(rows, 0)
            print(f"| {name} ({len(rows)}) | {network} |", " | ".join([f"{x:.3f}" for x in mean[:4]] + [f"{x:.2g}" for x in mean[4:]]), "|")


if __name__ == "__main__":
    main()
