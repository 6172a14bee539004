"""Golden values and gradients of the operations, by PyTorch and ptlflow in double precision.

    pip install ptlflow==0.4.2
    python tools/parity/ops.py crates/ops/tests/golden/pytorch.safetensors

Made with PyTorch 2.11. Inputs and the gradient of the output are not stored: both come from a rule over names and shapes,
which crates/ops/tests/pytorch.rs repeats. Written for each case, in single precision:
    CASE output    the output; of the windows of a lookup every 7th number
    CASE INPUT     the gradient of each input
"""

import sys
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from golden import name_hash, noise, write_safetensors
from ptlflow.models.gma.gma_utils import Aggregate, Attention
from ptlflow.models.raft.corr import CorrBlock
from ptlflow.models.raft.raft import RAFT
from ptlflow.models.raft.utils import bilinear_sampler, coords_grid
from ptlflow.models.rpknet.local_timm.norm import GroupNorm, LayerNorm2d
from ptlflow.models.skflow.update import PCBlock4_Deep_nopool_res
from ptlflow.models.unimatch.attention import single_head_split_window_attention
from ptlflow.models.unimatch.utils import generate_shift_window_attn_mask
from torch.func import functional_call

ACTIVATIONS = {
    "identity": lambda x: x,
    "relu": torch.relu,
    "leaky relu": lambda x: F.leaky_relu(x, 0.1),
    "gelu": F.gelu,
    "tanh": torch.tanh,
    "sigmoid": torch.sigmoid,
}
# Input (without batch), output channels, kernel, stride, padding. The last three have enough channels for Winograd's way.
CONVOLUTIONS = [
    ([4, 5, 6], 9, [1, 1], [1, 1], [0, 0]),
    ([4, 7, 8], 9, [1, 1], [2, 2], [0, 0]),
    ([3, 7, 9], 5, [3, 3], [2, 2], [1, 1]),
    ([3, 7, 9], 5, [3, 5], [1, 2], [0, 2]),
    ([3, 13, 16], 9, [7, 7], [2, 2], [3, 3]),
    ([16, 6, 7], 17, [3, 3], [1, 1], [1, 1]),
    ([16, 6, 7], 17, [1, 5], [1, 1], [0, 2]),
    ([16, 6, 7], 17, [5, 1], [1, 1], [2, 0]),
]
# The same, transposed: FlowNet's and one of uneven stride.
TRANSPOSED = [
    ([3, 4, 5], 2, [4, 4], [2, 2], [1, 1]),
    ([16, 3, 9], 17, [4, 4], [2, 2], [1, 1]),
    ([2, 4, 3], 3, [3, 5], [3, 2], [0, 2]),
]
# Kernel, padding.
DEPTHWISE = [([5, 3], [1, 0]), ([7, 7], [3, 3]), ([15, 15], [7, 7])]
# Levels, radius: RAFT's and RAFT-S's.
LOOKUPS = [(4, 4), (4, 3)]
EVERY = 7

stored = {}


def made_up(case, name, shape):
    """Weights of variance 1 / fan_in; positions and displacements that leave the image; the rest in -1..1."""
    u = noise(int(np.prod(shape)), name_hash(f"{case} {name}")).reshape(shape)
    if name.endswith("weight"):
        u = u * np.float32(np.sqrt(3.0 / np.prod(shape[1:])))
    elif name == "coords":
        u = np.float32(8) + np.float32(14) * u
    elif name in ("displacement", "mask"):
        u = np.float32(4) * u
    return torch.from_numpy(np.ascontiguousarray(u)).double()


def case(name, shapes, operation, every=1):
    leaves = {key: made_up(name, key, shape).requires_grad_() for key, shape in shapes.items()}
    output = operation(leaves)
    output.backward(made_up(name, "output", tuple(output.shape)))
    stored[f"{name} output"] = output.detach().flatten()[::every]
    for key, leaf in leaves.items():
        stored[f"{name} {key}"] = leaf.grad


def finished(sums, x, activation):
    return ACTIVATIONS[activation](sums + x["residual"] if "residual" in x else sums)


def conv2d(name, size, outputs, kernel, stride, padding, activation, residual):
    shapes = {"input": (2, *size), "weight": (outputs, size[0], *kernel), "bias": (outputs,)}
    if residual:
        out = [(s + 2 * p - k) // step + 1 for s, p, k, step in zip(size[1:], padding, kernel, stride)]
        shapes["residual"] = (2, outputs, *out)
    convolve = lambda x: F.conv2d(x["input"], x["weight"], x["bias"], stride, padding)
    case(f"conv2d {name}", shapes, lambda x: finished(convolve(x), x, activation))


def conv_transpose2d(name, size, outputs, kernel, stride, padding):
    shapes = {"input": (2, *size), "weight": (size[0], outputs, *kernel), "bias": (outputs,)}
    convolve = lambda x: F.conv_transpose2d(x["input"], x["weight"], x["bias"], stride, padding)
    case(f"conv_transpose2d {name}", shapes, lambda x: F.leaky_relu(convolve(x), 0.1))


def depthwise(name, size, kernel, padding, activation, residual):
    shapes = {"input": (2, *size), "weight": (size[0], 1, *kernel), "bias": size[:1]}
    if residual:
        shapes["residual"] = (2, size[0], *[s + 2 * p - k + 1 for s, p, k in zip(size[1:], padding, kernel)])
    convolve = lambda x: F.conv2d(x["input"], x["weight"], x["bias"], 1, padding, groups=size[0])
    case(f"depthwise {name}", shapes, lambda x: finished(convolve(x), x, activation))


def attention():
    """The reference's modules, whose projections pass on what they are given."""
    passed = lambda channels: {"weight": torch.eye(channels).double()[:, :, None, None]}
    weights = Attention(dim=6, position_only=False, position_and_content=False, heads=1, dim_head=3).double()
    weights.to_qk.load_state_dict(passed(6))
    aggregate = Aggregate(dim=2, heads=1, dim_head=2).double()
    aggregate.to_v.load_state_dict(passed(2))
    aggregate.gamma.data.fill_(1)

    def gather(x):
        return aggregate(weights(torch.cat([4 * x["queries"], x["keys"]], 1)), x["values"])

    case("attention", {"queries": (2, 3, 4, 5), "keys": (2, 3, 4, 5), "values": (2, 2, 4, 5)}, gather)


def windowed_attention():
    """UniMatch's in whole windows, and in windows that are rolled and masked."""
    shapes = {name: (2, 3, 4, 6) for name in ("queries", "keys", "values")}
    size, window = (4, 6), (2, 3)
    mask = generate_shift_window_attn_mask(size, *window, *(side // 2 for side in window), device="cpu").double()

    def attend(x, shifted):
        queries, keys, values = (x[name].flatten(2).transpose(1, 2) for name in shapes)
        out = single_head_split_window_attention(4 * queries, keys, values, 2, shifted, *size, mask)
        return out.transpose(1, 2).reshape(x["values"].shape)

    case("windowed attention", shapes, lambda x: attend(x, False))
    case("windowed attention shifted", shapes, lambda x: attend(x, True))


def skflow_block():
    """Its pointwise layers, and the depthwise ones of 1x1 and 15x15."""
    block = PCBlock4_Deep_nopool_res(6, 4, k_conv=[1, 15]).double()
    shapes = {"input": (2, 6, 8, 9), **{name: tuple(p.shape) for name, p in block.named_parameters()}}
    case("skflow block", shapes, lambda x: functional_call(block, {k: x[k] for k in x if k != "input"}, x["input"]))


def gru():
    """What the reference's ConvGRU does between its convolutions; update gates before reset gates."""
    gates, hidden = (2, 6, 4, 5), (2, 3, 4, 5)
    case("gru reset", {"gates": gates, "hidden": hidden}, lambda x: x["gates"][:, 3:] * x["hidden"])
    step = lambda z, h, q: (1 - z) * h + z * q
    update = lambda x: step(x["gates"][:, :3], x["hidden"], x["candidate"])
    case("gru update", {"gates": gates, "hidden": hidden, "candidate": hidden}, update)


def main(path):
    for activation in ACTIVATIONS:
        for residual in (False, True):
            name = f"{activation} added" if residual else activation
            conv2d(name, [3, 7, 9], 5, [3, 3], [1, 1], [1, 1], activation, residual)
            depthwise(name, [3, 9, 11], [7, 7], [3, 3], activation, residual)
    for number, sizes in enumerate(CONVOLUTIONS):
        conv2d(str(number), *sizes, "gelu", True)
    for number, sizes in enumerate(TRANSPOSED):
        conv_transpose2d(str(number), *sizes)
    for number, (kernel, padding) in enumerate(DEPTHWISE):
        depthwise(str(number), [3, 17, 19], kernel, padding, "gelu", True)
    for levels, radius in LOOKUPS:
        name = f"lookup {levels} {radius}"
        coords = made_up(name, "coords", (1, 2, 16, 17))
        windows = lambda x: CorrBlock(x["first"], x["second"], levels, radius)(coords)
        case(name, {"first": (1, 4, 16, 17), "second": (1, 4, 16, 17)}, windows, EVERY)
    grid = coords_grid(2, 5, 6, torch.float64, "cpu")
    sample = lambda x: bilinear_sampler(x["image"], (grid + x["displacement"]).permute(0, 2, 3, 1))
    case("warp", {"image": (2, 3, 5, 6), "displacement": (2, 2, 5, 6)}, sample)
    upsample = lambda x: RAFT.upsample_flow(None, x["flow"], 0.25 * x["mask"])
    case("upsample", {"flow": (2, 2, 3, 4), "mask": (2, 9 * 64, 3, 4)}, upsample)
    attention()
    windowed_attention()
    skflow_block()
    gru()
    for name, activation in ACTIVATIONS.items():
        normalize = lambda x: activation(F.instance_norm(x["input"], eps=1e-5))
        case(f"instance norm {name}", {"input": (2, 3, 5, 6)}, normalize)
        for kind, norm in [("group", GroupNorm(3, 6, affine=False)), ("layer", LayerNorm2d(6, affine=False))]:
            normalize = lambda x: activation(norm(x["input"]))
            case(f"{kind} norm {name}", {"input": (2, 6, 5, 7)}, normalize)
    for name in ("identity", "relu"):
        normalize = lambda x: ACTIVATIONS[name](F.batch_norm(x["input"], None, None, x["weight"], x["bias"], True))
        case(f"batch norm {name}", {"input": (4, 3, 5, 6), "weight": (3,), "bias": (3,)}, normalize)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_safetensors(path, {name: tensor.float().numpy() for name, tensor in stored.items()})


if __name__ == "__main__":
    main(Path(sys.argv[1]))
