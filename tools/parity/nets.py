"""Golden values for the networks: runs ptlflow's RAFT, RAFT-S, GMA and SKFlow on a made-up pair of frames.

    pip install ptlflow==0.4.2
    python tools/parity/nets.py crates/nets/tests/golden

Parameters and frames are not stored: both come from rules over names, shapes and positions, which
crates/nets/tests/parity.rs repeats. Written for each network and case, as safetensors:
    coarse_1     flow at an eighth of the padded size after 1 iteration, [batch, 2, height / 8, width / 8]
    coarse_12    the same after 12 iterations
    flow_12      flow after 12 iterations at every 7th row and column, [batch, 2, rows, columns]
and of a training step, for the mean over all numbers of (flow - [4, 2])^2, weighted with 0.8 towards the last of 3
iterations, with the running statistics of batch norm (running) and with those of the batch (batch):
    running/NAME, batch/NAME   the gradient of a parameter, 17 numbers of it: see `samples`
"""

import sys
from pathlib import Path

import numpy as np
import ptlflow
import torch
from golden import name_hash, noise, write_safetensors

# batch, height, width: one that needs no padding, one that does. The coarsest of four levels must be larger than one
# pixel, or the reference divides by zero.
CASES = [(1, 128, 160), (2, 133, 150)]
NETWORKS = ["raft", "raft_small", "gma", "skflow"]
EVERY = 7
# Parts of SKFlow's blocks that are added to their own input, four in a row: full weights would explode.
RESIDUAL = ["ffn1.2.", "conv_list.", "pw."]


def parameter(name, shape):
    """Weights of variance 1 / fan_in, so that activations keep their size; the rest near what training leaves."""
    u = noise(int(np.prod(shape)), name_hash(name)).reshape(shape)
    last = name.rsplit(".", 1)[-1]
    if last == "running_var":
        return np.float32(1) + np.float32(0.5) * u
    if last == "gamma":
        return np.float32(0.5) + np.float32(0.25) * u
    if last == "weight" and len(shape) == 1:
        return np.float32(1) + np.float32(0.25) * u
    if any(part in name for part in RESIDUAL):
        u = u * np.float32(0.5)
    if "flow_head.ffn2.2." in name:  # keeps SKFlow's flow inside the frame
        u = u * np.float32(0.25)
    if last == "weight":
        return u * np.float32(np.sqrt(3.0 / np.prod(shape[1:])))
    return np.float32(0.1) * u


def one_name(name, state):
    """What is stored twice is one parameter, named as downsample.1."""
    for twice in ("norm3.", "norm4."):
        owner, _, rest = name.partition(twice)
        if rest and f"{owner}downsample.1.{rest}" in state:
            return f"{owner}downsample.1.{rest}"
    return name


def wave(n, period):
    """A triangle wave of whole numbers, in 0..1."""
    return np.abs(n % (2 * period) - period) / period


def frame(batch, height, width, shift):
    """[batch, 3, height, width] in 0..1: three waves and some grain, moved by `shift` pixels right and half of it down."""
    n, c, y, x = np.meshgrid(
        np.arange(batch), np.arange(3), np.arange(height), np.arange(width), indexing="ij"
    )
    x, y = x - shift + 64, y - shift // 2 + 64
    grain = noise(1 << 18, 5)[(x + 331 * y + 7919 * c + 104729 * n) % (1 << 18)].astype(np.float64)
    value = 0.25 * wave(x + 2 * y + 5 * c, 13) + 0.25 * wave(3 * x - y + 1000 + 17 * n, 19)
    value = value + 0.3 * wave(x * y // 8 + 3 * c, 29) + 0.1 + 0.1 * grain
    return value.astype(np.float32)


def samples(gradient):
    """The root of the mean square, and 16 numbers at equal distances."""
    flat = gradient.ravel().astype(np.float64)
    return np.append(np.sqrt(np.mean(flat**2)), flat[np.arange(16) * flat.size // 16])


def gradients(model, images, batch_statistics):
    """By parameter, after a backward pass of the training loss."""
    model.iters = 3
    model.train()
    for module in model.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.train(batch_statistics)
            module.momentum = 0.0  # the running statistics stay
    model.zero_grad()
    flows = model({"images": images})["flow_preds"]
    truth = torch.tensor([4.0, 2.0]).reshape(1, 2, 1, 1)
    sum(0.8 ** (2 - i) * ((flow - truth) ** 2).mean() for i, flow in enumerate(flows)).backward()
    model.eval()
    state = model.state_dict()
    parameters = [(one_name(name, state), value) for name, value in model.named_parameters()]
    return {name: value.grad.numpy() for name, value in parameters if value.grad is not None}


def main(folder):
    folder.mkdir(parents=True, exist_ok=True)
    for network in NETWORKS:
        model = ptlflow.get_model(network).eval()
        state = model.state_dict()
        for name, value in state.items():
            if value.dtype == torch.float32:
                values = parameter(one_name(name, state), tuple(value.shape))
                state[name] = torch.from_numpy(np.ascontiguousarray(values))
        model.load_state_dict(state)
        for batch, height, width in CASES:
            pair = np.stack([frame(batch, height, width, shift) for shift in (0, 4)], axis=1)
            images = torch.from_numpy(pair[:, :, ::-1].copy())  # the reference takes BGR
            out = {}
            for iterations in (1, 12):
                model.iters = iterations
                with torch.no_grad():
                    result = model({"images": images})
                out[f"coarse_{iterations}"] = result["flow_small"].numpy()
            out["flow_12"] = result["flows"][:, 0, :, ::EVERY, ::EVERY].numpy()
            for kind, batch_statistics in [("running", False), ("batch", True)]:
                for name, gradient in gradients(model, images, batch_statistics).items():
                    out[f"{kind}/{name}"] = samples(gradient)
            write_safetensors(folder / f"{network}_{batch}x{height}x{width}.safetensors", out)
            sizes = {name: round(float(np.abs(value).mean()), 3) for name, value in out.items() if "/" not in name}
            print(network, (batch, height, width), "mean magnitudes", sizes)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
