"""Golden values for the networks: runs those of ptlflow, and others that it lacks, on a made-up pair of frames.

    pip install ptlflow==0.4.2
    python tools/parity/nets.py crates/nets/tests/golden [NETWORK...]

Parameters and frames are not stored: both come from rules over names, shapes and positions, which
crates/nets/tests/nets/parity.rs repeats. Written for each network and case, as NETWORK_BATCHxHEIGHTxWIDTH.safetensors:
    gain/PART    a number that parameters with PART in their name are multiplied with
    start        six numbers, of a network whose start is not the reference's: u of the coarse flow to start from is start[0] +
                 start[1] x + start[2] y in coarse pixels, v likewise of the last three
    coarse_N     after N iterations, the flow that a warm start takes, [batch, 2, rows, columns], where there is one
    flow_N       the flow after N iterations at every 7th row and column, [batch, 2, rows, columns]
    occlusion_N  likewise, the probability of occlusion, [batch, 1, rows, columns], of networks that give one
    log_weights_N, log_scales_N   likewise, of networks that give a mixture
    next_P_N     likewise, the flow of pair P of the video that the pair begins, of a network that remembers the pairs before
    setting/NAME what a network is set to, where that is not its default
and of a training step, where the reference can be trained, for the mean over all numbers of (flow - [4, 2])^2, and of a
mixture of (log_weights - [1, -1])^2 and (log_scales - [2, -2])^2, weighted with 0.8 towards the last of all flows that the
network gives, with the running statistics of batch norm (running) and, where there is batch norm, with those
of the batch (batch):
    training_iterations   how many
    training_pairs   pairs of the video over which the loss is summed, of a network that remembers the pairs before
    running/NAME, batch/NAME   the gradient of a parameter, 17 numbers of it: see `samples`
    gradients/NETWORK   in place of these, where they are stored for a network of the same parts
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import ptlflow
import torch
import torch.nn.functional as F
from flownet3 import FlowNet3
from golden import name_hash, noise, write_safetensors
from ptlflow.utils.utils import InputScaler
from srflow_net import COARSEST_STRIDE, SrFlow
from ssa import Ssa

EVERY = 7


@dataclass
class Network:
    """A network of ptlflow or of its own file here, and how it is run. The first case needs no padding, the second does."""

    name: str
    # Of each forward pass, and of the training step; 0 where the reference cannot be trained.
    iterations: tuple = (1, 12)
    training_iterations: int = 3
    # Name of the model's attribute that holds the iterations.
    attribute: str = "iters"
    # Batch, height, width.
    cases: tuple = ((1, 128, 160), (2, 133, 150))
    # Of the model's class, where they are not its defaults.
    arguments: dict = field(default_factory=dict)
    # Pairs of a video, of a network that remembers the pairs before.
    pairs: int = 1
    # Arguments of the model that are settings here, and their values.
    settings: dict = field(default_factory=dict)
    # What stands before every name of a parameter.
    prefix: str = ""
    # Parts of names of parameters, and what those are multiplied with, so that activations and flow keep their size.
    gains: dict = field(default_factory=dict)
    # Whether it gives a mixture of Laplace distributions beside each flow, as SEA-RAFT does.
    mixture: bool = False
    # The coarse flow to start from, see above, and the pixels of a padded frame for each of its own.
    start: tuple = ()
    start_stride: int = 0
    # A network of the same parts whose gradients are stored.
    gradients: str = ""
    # The flows that training compares with the truth, in full size, the last one last: from the outputs and the frames.
    flows: Callable = lambda outputs, images: outputs["flow_preds"]
    # Pixels of a padded frame for each of the flow that a warm start takes, where the reference makes it of a finer one.
    coarsest: int = 0
    # What the attribute is set to for so many iterations.
    set_iterations: Callable = lambda iterations: iterations
    # A further case without gradients: batch, height and width, what the model's attributes are set to, and our settings.
    set_to: tuple = ()
    # Makes the model, where it is none of ptlflow's.
    model: Callable = None


def flownet_flows(outputs, images):
    """FlowNet gives five flows, each in its own size, the finest first; the reference enlarges the finest in this way."""
    scaler = InputScaler(images.shape, stride=64, interpolation_align_corners=True)
    size = (scaler.tgt_height, scaler.tgt_width)
    enlarged = [20 * F.interpolate(flow, size, mode="bilinear") for flow in reversed(outputs["flow_preds"])]
    return [scaler.unfill(flow, is_flow=True) for flow in enlarged]


# Of SKFlow's blocks, whose parts are added to their own input, four in a row: full weights would explode. The last keeps the
# flow inside the frame.
SUPER_KERNELS = {"ffn1.2.": 0.5, "conv_list.": 0.5, "pw.": 0.5, "flow_head.ffn2.2.": 0.25}


def sea_raft(name, iterations, flow_head, **more):
    """Its encoders' blocks add to their input; full weights would explode, and hardly upsample by other than the mean."""
    gains = {".conv2.": 0.4, "upsample_weight.2.": 8, "flow_head.2.": flow_head}
    return Network(name, iterations=iterations, gains=gains, mixture=True, **more)


def unimatch(name, gains, **more):
    """With full weights, scores are so large that the softmax jumps between pixels."""
    return Network(name, attribute="num_reg_refine", cases=((1, 128, 160), (2, 100, 150)), gains=gains, **more)


# A fine scale warps features, as FlowNet2-CSS warps frames.
UNIMATCH_SC2 = {"q_proj.": 0.3, "trident_conv.": 0.3, "flow_head.conv2.": 0.25}


# FlowNet has no norm, and every leaky ReLU halves the variance.
FLOWNET = {
    "iterations": (1,),
    "training_iterations": 1,
    "cases": ((1, 128, 192), (2, 100, 150)),
    "gains": {"conv": 1.7, "upsampled": 2.0, "predict_flow": 1.5},
    "flows": flownet_flows,
}

def ccmr(name, levels, **more):
    """In each level as many iterations as are in proportion to those of the finest."""
    gains = {"gamma": 8, "temperature": 30, "flow_head.conv2.": 0.5}
    set_iterations = lambda finest: [-(-own * finest // levels[-1]) for own in levels]
    return Network(name, iterations=(1, levels[-1]), gains=gains, set_iterations=set_iterations, **more)


# The coarsest of four levels of a correlation pyramid must be larger than one pixel, or the reference divides by zero.
NETWORKS = [
    Network(
        "srflow",
        iterations=(1, 2),
        training_iterations=2,
        gains={"enter.": 2.0, "down.": 1.6, "up.": 1.6, "mask.": 2.0, "predict.": 0.25},
        mixture=True,
        start=(1.5, 0.01, -0.005, 1.25, -0.005, 0.01),
        start_stride=2,
        model=SrFlow,
    ),
    Network("raft"),
    Network("raft_small"),
    Network("gma"),
    Network("skflow", gains=SUPER_KERNELS),
    # Weights that the reference cut out and kept without gradients would have none in training.
    Network("rpknet", gains={"flow_head.conv2.": 0.5}, arguments={"cache_pkconv_weights": False}),
    sea_raft("sea_raft_s", (1, 4), 2),
    sea_raft("sea_raft_m", (1, 4), 1, gradients="sea_raft_s"),
    sea_raft("sea_raft_l", (1, 12), 0.5, gradients="sea_raft_s"),
    # Crops of 128x160, and what is remembered is full from the fourth pair on.
    Network(
        "memflow",
        attribute="decoder_depth",
        pairs=4,
        prefix="network.",
        settings={"train_avg_length": 480},
        gains={**SUPER_KERNELS, "to_qk.": 4},
    ),
    Network("flownets", **FLOWNET),
    Network("flownetc", **FLOWNET),
    unimatch("unimatch", {"q_proj.": 0.5, "feature_flow_attn.": 0.7}, iterations=(1,), training_iterations=1),
    unimatch("unimatch_sc2", UNIMATCH_SC2, iterations=(1,), gradients="unimatch_sc2_ref6"),
    unimatch("unimatch_sc2_ref6", UNIMATCH_SC2, iterations=(1, 6)),
    # Stacked, large flows through frames full of grain would enlarge every rounding error.
    Network("flownetcss", **{**FLOWNET, "gains": {"conv": 1.7, "upsampled": 2.0, "predict_flow": 0.75}}),
    Network(
        "dpflow",
        iterations=(1, 4),
        training_iterations=2,
        attribute="iters_per_level",
        gains={"flow_head.conv2.": 0.5},
        mixture=True,
        coarsest=32,
        set_to=((1, 100, 140), {"pyramid_levels": 4, "output_stride": 64}, {"levels": 4}),
    ),
    Network(
        "flownet3_css",
        iterations=(1,),
        training_iterations=1,
        cases=FLOWNET["cases"],
        gains={"conv": 1.7, "predict": 2.0},
        model=FlowNet3,
    ),
    ccmr("ccmr", (8, 10, 15), gradients="ccmr_p"),
    ccmr("ccmr_p", (8, 10, 10, 10), training_iterations=2),
    # Frames in 0..255, and gains for the rest as for FlowNet.
    Network(
        "ssa",
        iterations=(1,),
        training_iterations=1,
        cases=FLOWNET["cases"],
        gains={"conv1.": 0.008, "conv": 1.7, "join": 1.4, "predict": 2.0},
        model=Ssa,
    ),
]


def parameter(name, shape, gains):
    """Weights of variance 1 / fan_in, so that activations keep their size; the rest near what training leaves."""
    u = noise(int(np.prod(shape)), name_hash(name)).reshape(shape)
    for part, gain in gains.items():
        if part in name:
            u = u * np.float32(gain)
    last = name.rsplit(".", 1)[-1]
    if last == "running_var":
        return np.float32(1) + np.float32(0.5) * u
    if last == "gamma":
        return np.float32(0.5) + np.float32(0.25) * u
    if last == "weight" and len(shape) == 1:
        return np.float32(1) + np.float32(0.25) * u
    if last == "weight":
        return u * np.float32(np.sqrt(3.0 / np.prod(shape[1:])))
    return np.float32(0.1) * u


def inputs(network, images, goes_on=False, ends=False):
    """Of a pair; of a network that remembers, the first of a video unless that goes on, and remembered unless it ends."""
    if network.start:
        return {"images": images, "start": start(network, images)}
    if network.pairs == 1:
        return {"images": images}
    return {"images": images, "meta": {"is_seq_start": not goes_on, "is_seq_end": ends}}


def start(network, images):
    batch, _, _, *size = images.shape
    height, width = (-(-side // COARSEST_STRIDE) * COARSEST_STRIDE // network.start_stride for side in size)
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    flow = torch.stack([base + of_x * x + of_y * y for base, of_x, of_y in (network.start[:3], network.start[3:])])
    return flow.expand(batch, -1, -1, -1)


def one_name(network, name, state):
    """What is stored twice is one parameter, named as downsample.1."""
    return shared_name(name, state).removeprefix(network.prefix)


def shared_name(name, state):
    for twice in ("norm3.", "norm4.", "bn3."):
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


def every_flow(network, model, images):
    """The flow after each iteration, of which a model without training code gives the last one, and the mixtures."""
    found = model(inputs(network, images))
    if "flow_preds" in found:
        return network.flows(found, images), found.get("info_preds")
    return flow_by_iterations(network, model, inputs(network, images)), None


def flow_by_iterations(network, model, pair):
    flows = []
    for iterations in range(1, network.training_iterations + 1):
        setattr(model, network.attribute, iterations)
        flows.append(model(pair)["flows"][:, 0])
    return flows


def with_mixtures(model):
    """DPFlow computes its mixtures for its loss alone: gives them as SEA-RAFT does."""
    predict, forward = model.predict, model.forward
    found = {}

    def predicted(*arguments, **named):
        result = predict(*arguments, **named)
        found["info_preds"] = result[3]
        return result

    def forwarded(pair):
        batch, _, _, height, width = pair["images"].shape
        truth = torch.zeros(batch, 1, 2, height, width)  # of its loss, which nobody reads
        return {**forward({**pair, "flows": truth}), **found}

    model.predict, model.forward = predicted, forwarded


def without_chance(model):
    """CCMR leaves out branches by chance in training. Its authors' correlation has no gradient of the positions."""
    module = sys.modules[type(model).forward.__module__]

    look_up = module.get_corr_block

    def detached(**named):
        correlation = look_up(**named)
        return lambda coords: correlation(coords.detach())

    module.get_corr_block = detached
    for part in model.modules():
        if type(part).__name__ == "DropPath":
            part.drop_prob = 0.0


def coarse(stride, flow):
    """The flow that a warm start takes, from what the reference gives the next pair."""
    if not stride:
        return flow
    size = [side * 8 // stride for side in flow.shape[2:]]
    smaller = torch.nn.functional.interpolate(flow, size, mode="bilinear", align_corners=True)
    return smaller * (8 / stride)


def gradients(network, model, video, batch_statistics):
    """By parameter, after a backward pass of the training loss."""
    setattr(model, network.attribute, network.set_iterations(network.training_iterations))
    model.train()
    for module in model.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.train(batch_statistics)
            module.momentum = 0.0  # the running statistics stay
    model.zero_grad()
    flows, mixtures = every_flow(network, model, video[:, :2])
    distance = lambda found, truth: ((found - torch.tensor(truth).reshape(1, 2, 1, 1)) ** 2).mean()
    losses = [distance(flow, [4.0, 2.0]) for flow in flows]
    if network.mixture:
        losses = [
            loss + distance(mixture[:, :2], [1.0, -1.0]) + distance(mixture[:, 2:], [2.0, -2.0])
            for loss, mixture in zip(losses, mixtures, strict=True)
        ]
    decayed = lambda losses: sum(0.8 ** (len(losses) - 1 - i) * loss for i, loss in enumerate(losses))
    total = decayed(losses)
    if network.pairs > 1:
        second = inputs(network, video[:, 1:3], goes_on=True, ends=True)
        total = total + decayed([distance(flow, [4.0, 2.0]) for flow in flow_by_iterations(network, model, second)])
    total.backward()
    model.eval()
    state = model.state_dict()
    parameters = [(one_name(network, name, state), value) for name, value in model.named_parameters()]
    return {name: value.grad.numpy() for name, value in parameters if value.grad is not None}


def last_mixture(network, model, images):
    """Log weights and log scales beside the last flow, which the reference only gives in training."""
    model.training = True  # of the model alone: batch norm stays as it is
    with torch.no_grad():
        mixture = model(inputs(network, images))["info_preds"][-1]
    model.training = False
    return mixture[:, :2], mixture[:, 2:]


def write(network, folder):
    make = network.model or ptlflow.get_model_reference(network.name)
    model = make(**network.arguments, **network.settings).eval()
    state = model.state_dict()
    for name, value in state.items():
        if value.dtype == torch.float32:
            values = parameter(one_name(network, name, state), tuple(value.shape), network.gains)
            state[name] = torch.from_numpy(np.ascontiguousarray(values))
    model.load_state_dict(state)
    if network.name == "dpflow":
        with_mixtures(model)
    if network.name.startswith("ccmr"):
        without_chance(model)
    cases = [(size, {}, network.settings) for size in network.cases]
    for (batch, height, width), attributes, settings in [*cases, *filter(None, [network.set_to])]:
        for name, value in attributes.items():
            setattr(model, name, value)
        stride = attributes.get("output_stride", network.coarsest)
        video = np.stack([frame(batch, height, width, 4 * number) for number in range(network.pairs + 1)], axis=1)
        video = torch.from_numpy(video[:, :, ::-1].copy())  # the reference takes BGR
        images = video[:, :2]
        out = {f"gain/{part}": np.array([gain]) for part, gain in network.gains.items()}
        out |= {"start": np.array(network.start)} if network.start else {}
        out |= {f"setting/{name}": np.array([value]) for name, value in settings.items()}
        for iterations in network.iterations:
            setattr(model, network.attribute, network.set_iterations(iterations))
            with torch.no_grad():
                result = model(inputs(network, images))
            # CCMR's is of the frame without its border, and does not fit where there is one.
            if "flow_small" in result and not (network.name.startswith("ccmr") and (height % 32 or width % 32)):
                out[f"coarse_{iterations}"] = coarse(stride, result["flow_small"]).numpy()
            out[f"flow_{iterations}"] = result["flows"][:, 0, :, ::EVERY, ::EVERY].numpy()
            if "occlusion" in result:
                out[f"occlusion_{iterations}"] = result["occlusion"][:, :, ::EVERY, ::EVERY].numpy()
            if network.mixture:
                for part, values in zip(("log_weights", "log_scales"), last_mixture(network, model, images)):
                    out[f"{part}_{iterations}"] = values[:, :, ::EVERY, ::EVERY].numpy()
            for number in range(1, network.pairs):
                with torch.no_grad():
                    result = model(inputs(network, video[:, number : number + 2], goes_on=True))
                out[f"next_{number + 1}_{iterations}"] = result["flows"][:, 0, :, ::EVERY, ::EVERY].numpy()
        if network.gradients:
            out[f"gradients/{network.gradients}"] = np.array([1])
        elif network.training_iterations and not attributes:
            out["training_iterations"] = np.array([network.training_iterations])
            out |= {"training_pairs": np.array([2])} if network.pairs > 1 else {}
            normed = any(isinstance(module, torch.nn.BatchNorm2d) for module in model.modules())
            for kind, batch_statistics in [("running", False), ("batch", True)][: 1 + normed]:
                for name, gradient in gradients(network, model, video, batch_statistics).items():
                    out[f"{kind}/{name}"] = samples(gradient)
        write_safetensors(folder / f"{network.name}_{batch}x{height}x{width}.safetensors", out)
        sizes = {name: round(float(np.abs(value).mean()), 3) for name, value in out.items() if "_" in name and "/" not in name}
        print(network.name, (batch, height, width), "mean magnitudes", sizes)


def main(folder, names):
    folder.mkdir(parents=True, exist_ok=True)
    for network in NETWORKS:
        if not names or network.name in names:
            write(network, folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
