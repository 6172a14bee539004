#!/usr/bin/env python3
"""Golden values and gradients of the losses, from the equations of the SRFlow paper (arXiv 2601.06479) and torch's autograd.

    pip install torch
    tools/parity/losses.py

Writes crates/train/tests/golden/losses.safetensors: the inputs in float32; for each case its loss and the gradients by what
the network predicts, computed in float64 from those inputs. Made with torch 2.11.
"""

import math
from pathlib import Path

import torch
import torch.nn.functional as F
from golden import write_safetensors

FILE = Path(__file__).resolve().parents[2] / "crates/train/tests/golden/losses.safetensors"
BATCH, HEIGHT, WIDTH, PREDICTIONS = 2, 9, 12, 3
GAMMA, MAX_MAGNITUDE = 0.8, 400.0
SOBEL = torch.tensor([[-1.0, 0.0, 1.0], [-2.0, 0.0, 2.0], [-1.0, 0.0, 1.0]], dtype=torch.float64)


def make_inputs():
    """Frames of which one part is nearly flat and the other busy, so that the weights of MIGAR and IGVAR are neither all 0
    nor all 1; masks with an outline; unknown and very fast pixels."""
    torch.manual_seed(11)
    truth = 3 * torch.randn(BATCH, 2, HEIGHT, WIDTH)
    valid = (torch.rand(BATCH, 1, HEIGHT, WIDTH) < 0.8).float()
    truth[0, 0, 4, 5], valid[0, 0, 4, 5] = 500.0, 1.0
    x = torch.arange(WIDTH)
    busy = (x >= 7).float()
    frame = 0.5 + (0.0002 + busy * 0.1) * (torch.rand(BATCH, 3, HEIGHT, WIDTH) - 0.5)
    foreground = torch.zeros(BATCH, 1, HEIGHT, WIDTH)
    foreground[0, 0, 1:8, 2:11] = 1
    foreground[1, 0, 3:, :9] = 1
    foreground[1, 0, 5, 4] = 0
    flows = [truth + torch.randn_like(truth) for _ in range(PREDICTIONS)]
    log_weights = [torch.randn(BATCH, 2, HEIGHT, WIDTH) for _ in range(PREDICTIONS)]
    log_scales = [2 * torch.randn(BATCH, 2, HEIGHT, WIDTH) for _ in range(PREDICTIONS)]
    second = (frame + 0.05 * torch.randn_like(frame)).clamp(0, 1)
    return dict(
        truth=truth, valid=valid, first_frame=frame, second_frame=second, foreground=foreground,
        **{f"flow_{i}": t for i, t in enumerate(flows)},
        **{f"log_weights_{i}": t for i, t in enumerate(log_weights)},
        **{f"log_scales_{i}": t for i, t in enumerate(log_scales)},
    )  # fmt: skip


def sobel(image, border):
    """One correlation with the 3x3 kernels for each channel."""
    padded = F.pad(image, (1, 1, 1, 1), mode="replicate" if border == "replicate" else "constant")
    apply = lambda kernel: torch.cat([F.conv2d(c, kernel[None, None]) for c in padded.split(1, dim=1)], dim=1)
    return apply(SOBEL), apply(SOBEL.T)


def tvr(flow, inputs, border):
    """Equations 9 and 10, without the sum over predictions."""
    total = 0
    for c in (flow[:, :1], flow[:, 1:]):
        gx, gy = sobel(c, border)
        total = total + (gx.abs() / 8 + gy.abs() / 8).mean(dim=(1, 2, 3))
    return 0.05 * total.mean()


def fdr(flow, inputs, border):
    """Equations 11 and 12; 1 / (H W) as in equation 9."""
    mask = inputs["foreground"]
    dx = (flow[..., :, 1:] - flow[..., :, :-1]).abs() * mask[..., :, :-1]
    dy = (flow[..., 1:, :] - flow[..., :-1, :]).abs() * mask[..., :-1, :]
    total = dx.sum(dim=(1, 2, 3)) + dy.sum(dim=(1, 2, 3))
    return 0.05 * (total / (HEIGHT * WIDTH)).mean()


def gradient_magnitude(inputs, border, image_max):
    """Equation 13."""
    gx, gy = sobel(image_max * inputs["first_frame"], border)
    return sum(torch.sqrt(gx[:, c] ** 2 + gy[:, c] ** 2) for c in range(3)) / 3


def total_mask(inputs, border, reading):
    """Equation 16."""
    mask = inputs["foreground"]
    gx, gy = sobel(mask, border)
    if reading == "interior":
        return mask * ((gx == 0) & (gy == 0))
    return mask * ((gx > 0) & (gy > 0))


def weighted(flow, weights, mask, border):
    """Equations 17 and 18, without the sum over predictions."""
    total = 0
    for c in (flow[:, :1], flow[:, 1:]):
        gx, gy = sobel(c * mask, border)
        total = total + (weights[:, None] * (gx.abs() + gy.abs())).mean(dim=(1, 2, 3))
    return total.mean()


def migar(flow, inputs, border, image_max=255.0, reading="interior"):
    """Equations 14 and 15. The powers are taken as printed: float64 holds them here."""
    gradient = gradient_magnitude(inputs, border, image_max)
    weights = torch.stack([torch.exp(g.mean()) ** -g for g in gradient])
    return weighted(flow, weights, total_mask(inputs, border, reading), border)


def igvar(flow, inputs, border, image_max=255.0, reading="interior"):
    """Equation 19."""
    gradient = gradient_magnitude(inputs, border, image_max)
    weights = []
    for g, mask in zip(gradient, inputs["foreground"][:, 0]):
        base = max((g[mask == 1].var(unbiased=False) / 100).item(), math.e)
        weights.append(base**-g)
    return weighted(flow, torch.stack(weights), total_mask(inputs, border, reading), border)


def counted(inputs):
    magnitude = (inputs["truth"] ** 2).sum(dim=1, keepdim=True).sqrt()
    return (inputs["valid"] >= 0.5) & (magnitude < MAX_MAGNITUDE)


def l1(flow, inputs):
    """RAFT's and SKFlow's."""
    return (counted(inputs) * (flow - inputs["truth"]).abs()).mean()


def l2(flow, inputs):
    return (counted(inputs)[:, 0] * torch.linalg.vector_norm(flow - inputs["truth"], dim=1)).mean()


def mixture(flow, inputs, log_weights, log_scales):
    """SEA-RAFT's, written as a density."""
    scales = torch.exp(torch.stack([log_scales[:, 0].clamp(0, 10), log_scales[:, 1].clamp(0, 0)], dim=1))
    weights = torch.softmax(log_weights, dim=1)
    distance = (flow - inputs["truth"]).abs()
    density = sum(
        weights[:, None, k] / (2 * scales[:, None, k]) * torch.exp(-distance / scales[:, None, k]) for k in range(2)
    )
    mask = counted(inputs).expand_as(distance)
    return -torch.log(density)[mask].mean()


def l1_and_mixture(flow, inputs, log_weights, log_scales):
    distance = (flow - inputs["truth"]).abs()
    distance = distance[counted(inputs).expand_as(distance)].mean()
    return distance + 0.2 * mixture(flow.detach(), inputs, log_weights, log_scales)


def strain(flow, inputs):
    """Of differences to the right and lower neighbour, where both are counted."""
    error, counts = torch.where(counted(inputs), flow - inputs["truth"], 0), counted(inputs)
    total = 0
    for axis in (2, 3):
        both = counts.narrow(axis, 1, counts.shape[axis] - 1) & counts.narrow(axis, 0, counts.shape[axis] - 1)
        total = total + (both * error.diff(dim=axis).abs()).sum()
    return total / counts.numel()


def cyclic(flow, inputs):
    """SSA's: frame 1 at p - flow(p), clamped to the frame, against frame 2."""
    y, x = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
    x, y = (x - flow[:, 0]).clamp(0, WIDTH - 1), (y - flow[:, 1]).clamp(0, HEIGHT - 1)
    grid = torch.stack([2 * x / (WIDTH - 1) - 1, 2 * y / (HEIGHT - 1) - 1], dim=-1)
    warped = F.grid_sample(inputs["first_frame"], grid, align_corners=True, padding_mode="border")
    return F.huber_loss(255 * warped, 255 * inputs["second_frame"])


def over_predictions(loss, inputs):
    total = 0
    for i in range(PREDICTIONS):
        total = total + GAMMA ** (PREDICTIONS - 1 - i) * loss(i)
    return total


def main():
    stored = make_inputs()
    inputs = {name: tensor.double() for name, tensor in stored.items()}
    out = dict(stored)

    def case(name, loss, by=("flow",)):
        leaves = {f"{b}_{i}": inputs[f"{b}_{i}"].clone().requires_grad_() for b in by for i in range(PREDICTIONS)}
        value = over_predictions(lambda i: loss(*[leaves[f"{b}_{i}"] for b in by]), inputs)
        value.backward()
        out[f"{name}.value"] = value.detach().reshape(1)
        for leaf, tensor in leaves.items():
            out[f"{name}.{leaf}"] = tensor.grad
        print(f"{name}: {value.item():.6f}")

    case("l1", lambda flow: l1(flow, inputs))
    case("l2", lambda flow: l2(flow, inputs))
    predicted = ("flow", "log_weights", "log_scales")
    case("mixture", lambda flow, weights, scales: mixture(flow, inputs, weights, scales), predicted)
    both = lambda flow, weights, scales: l1_and_mixture(flow, inputs, weights, scales)
    case("l1 and mixture", both, predicted)
    for border in ("replicate", "zero"):
        case(f"tvr {border}", lambda flow: tvr(flow, inputs, border))
        case(f"migar {border}", lambda flow: migar(flow, inputs, border, image_max=255.0 if border == "replicate" else 1.0))
        case(f"igvar {border}", lambda flow: igvar(flow, inputs, border))
    case("strain", lambda flow: strain(flow, inputs))
    case("cyclic", lambda flow: cyclic(flow, inputs))
    case("fdr", lambda flow: fdr(flow, inputs, None))
    case("migar unit", lambda flow: migar(flow, inputs, "replicate", image_max=1.0))
    case("igvar unit", lambda flow: igvar(flow, inputs, "replicate", image_max=1.0))
    case("migar literal", lambda flow: migar(flow, inputs, "replicate", reading="literal"))
    case("igvar literal", lambda flow: igvar(flow, inputs, "replicate", reading="literal"))
    every = [tvr, fdr, migar, igvar]
    case("all", lambda flow: l1(flow, inputs) + sum(loss(flow, inputs, "replicate") for loss in every))
    FILE.parent.mkdir(parents=True, exist_ok=True)
    write_safetensors(FILE, {name: tensor.detach().float().numpy() for name, tensor in out.items()})


if __name__ == "__main__":
    main()
