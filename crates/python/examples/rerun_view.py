"""Shows a dataset, its flow and Gaussians in Rerun (https://rerun.io): pip install 'rerun-sdk>=0.41', then

    python rerun_view.py srflow:DIR                # frames, flow, masks and the flow of srflow on a timeline
    python rerun_view.py srflow:DIR --ply head.ply # and a file of Gaussians
    python rerun_view.py srflow:DIR --save out.rrd # into a file, for `rerun out.rrd`
"""

import argparse

import numpy as np
import rerun as rr
import srflow


def log_pairs(dataset, limit):
    network = srflow.Network()
    for number in range(min(len(dataset), limit)):
        pair = dataset[number]
        rr.set_time("pair", sequence=number)
        rr.log("pair/frame1", rr.Image(pair["frame1"]))
        rr.log("pair/frame2", rr.Image(pair["frame2"]))
        estimate = network(pair["frame1"], pair["frame2"])
        flows = {"estimate": estimate} | ({"truth": pair["flow"]} if "flow" in pair else {})
        longest = np.nanmax(np.linalg.norm(flows.get("truth", estimate), axis=-1))
        for name, flow in flows.items():
            rr.log(f"flow/{name}", rr.Image(srflow.flow_to_rgb(flow, max_flow=max(float(longest), 1e-3))))
            log_arrows(f"pair/frame1/{name}", flow)
        if "truth" in flows:
            error = np.linalg.norm(estimate - flows["truth"], axis=-1)
            rr.log("flow/error", rr.DepthImage(np.nan_to_num(error), colormap="inferno"))
            rr.log("epe", rr.Scalars(srflow.metrics(estimate, flows["truth"])["epe"]))
        if "mask" in pair:
            rr.log("pair/mask", rr.SegmentationImage(pair["mask"].astype(np.uint8)))


def log_arrows(path, flow, spacing=16):
    ys, xs = np.mgrid[spacing // 2 : flow.shape[0] : spacing, spacing // 2 : flow.shape[1] : spacing]
    vectors = flow[ys, xs].reshape(-1, 2)
    known = np.isfinite(vectors).all(axis=1)
    origins = np.stack([xs, ys], axis=-1).reshape(-1, 2) + 0.5  # Rerun's pixels begin at their corners
    rr.log(path, rr.Arrows2D(origins=origins[known], vectors=vectors[known]))


def log_gaussians(path, gaussians):
    base, rest = gaussians.sh[:, :1], gaussians.sh[:, 1:]
    color = np.clip(0.5 + 0.28209479 * base[:, 0], 0, 1)
    harmonics = np.zeros((len(gaussians), 15, 3), np.float32)
    harmonics[:, : rest.shape[1]] = rest
    rr.log(
        path,
        rr.GaussianSplats3D(
            gaussians.means,
            scales=gaussians.scales,
            quaternions=gaussians.rotations,
            colors=np.column_stack([color, gaussians.opacities]),
            sh_coefficients=harmonics,
        ),
        rr.ViewCoordinates.RIGHT_HAND_Y_UP,
        static=True,
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", help="KIND:DIR")
    parser.add_argument("--split")
    parser.add_argument("--limit", type=int, default=50, help="pairs (default: 50)")
    parser.add_argument("--ply", help="a file of 3D Gaussian Splatting")
    parser.add_argument("--save", help="write this .rrd file, without opening the viewer")
    arguments = parser.parse_args()
    rr.init("srflow", spawn=arguments.save is None)
    if arguments.save:
        rr.save(arguments.save)
    log_pairs(srflow.Dataset(arguments.dataset, split=arguments.split), arguments.limit)
    if arguments.ply:
        log_gaussians("gaussians", srflow.Gaussians.read(arguments.ply))


if __name__ == "__main__":
    main()
