"""The network that comes with srflow (crates/nets/src/srflow.rs) in PyTorch, as its definition.

Takes and gives what ptlflow's models do: see tools/parity/nets.py.
"""

import torch
import torch.nn.functional as F
from torch import nn

CHANNELS = (24, 48, 64, 64)
STRIDES = (4, 8, 16)
RADII = (3, 3, 4)
MATCHING = 64
STATE = 32
WIDTHS = (32, 64, 96)
OUTPUTS = 6
EVIDENCE = 8
NOISE = 1.4e-4
REACH = 2.0


def conv(inputs, outputs, stride=1):
    return nn.Conv2d(inputs, outputs, 3, stride, 1)


def leaky(x):
    return F.leaky_relu(x, 0.1)


def warp(image, flow):
    """`image` at each pixel displaced by `flow`; beyond the border that of the nearest pixel."""
    height, width = image.shape[2:]
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    x, y = (x + flow[:, 0]).clamp(0, width - 1), (y + flow[:, 1]).clamp(0, height - 1)
    grid = torch.stack([2 * x / max(width - 1, 1) - 1, 2 * y / max(height - 1, 1) - 1], dim=-1)
    return F.grid_sample(image, grid, mode="bilinear", align_corners=True)


def windows(first, second, flow, radius):
    """Correlation of each pixel of `first` with `second` around where the flow points to, zero outside, as RAFT orders it."""
    batch, channels, height, width = first.shape
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    x, y = x + flow[:, 0], y + flow[:, 1]
    found = []
    for dx in range(-radius, radius + 1):
        for dy in range(-radius, radius + 1):
            grid = torch.stack([2 * (x + dx) / (width - 1) - 1, 2 * (y + dy) / (height - 1) - 1], dim=-1)
            there = F.grid_sample(second, grid, mode="bilinear", align_corners=True)
            found.append((first * there).sum(1) / channels**0.5)
    return torch.stack(found, dim=1)


def resized(x, size):
    return F.interpolate(x, size, mode="bilinear", align_corners=False)


def resized_flow(flow, size):
    scale = torch.tensor([size[1] / flow.shape[3], size[0] / flow.shape[2]]).reshape(1, 2, 1, 1)
    return resized(flow, size) * scale


def lucas_kanade(first, second):
    first, second = (frame.detach().mean(1, keepdim=True) for frame in (first, second))
    change = second - first
    mean = F.pad((first + second) / 2, (1, 1, 1, 1), mode="replicate")
    x = (mean[:, :, 1:-1, 2:] - mean[:, :, 1:-1, :-2]) / 2
    y = (mean[:, :, 2:, 1:-1] - mean[:, :, :-2, 1:-1]) / 2
    products = F.avg_pool2d(torch.cat([x * x, x * y, y * y, x * change, y * change], 1), 2)
    found = []
    for radius in (1, 3):
        sums = F.avg_pool2d(products, 2 * radius + 1, 1, radius, count_include_pad=False)
        xx, xy, yy, xt, yt = sums.split(1, dim=1)
        determinant = (xx + NOISE) * (yy + NOISE) - xy * xy
        u = (xy * yt - (yy + NOISE) * xt) / determinant
        v = (xy * xt - (xx + NOISE) * yt) / determinant
        found += [u.clamp(-REACH, REACH), v.clamp(-REACH, REACH), xx / (xx + NOISE), yy / (yy + NOISE)]
    return torch.cat(found, 1)


def evidence(first, second, flow):
    warped = warp(second, resized_flow(flow, first.shape[2:]))
    return warped, lucas_kanade(first, warped)


def cells(x):
    return F.pixel_unshuffle(x, 2)


def twice(x):
    return F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)


def convex_upsample(flow, mask):
    batch, _, height, width = flow.shape
    weights = mask.reshape(batch, 1, 9, 2, 2, height, width).softmax(dim=2)
    around = F.unfold(2 * flow, 3, padding=1).reshape(batch, 2, 9, 1, 1, height, width)
    return (weights * around).sum(2).permute(0, 1, 4, 2, 5, 3).reshape(batch, 2, 2 * height, 2 * width)


class Step(nn.Module):
    def __init__(self, inputs, outputs):
        super().__init__()
        self.down, self.same = conv(inputs, outputs, 2), conv(outputs, outputs)

    def forward(self, x):
        return leaky(self.same(leaky(self.down(x))))


def changed(flow, evidence, predicted):
    """By the evidence of the larger window, in pixels of frames that are twice as large as the flow, and the prediction."""
    return flow + evidence[:, 4:6] / 2 + predicted[:, :2]


class Matching(nn.Module):
    def __init__(self, radius, channels):
        super().__init__()
        self.radius = radius
        self.conv1 = conv((2 * radius + 1) ** 2 + 2 * channels + EVIDENCE + 2 + STATE, MATCHING)
        self.conv2, self.conv3 = conv(MATCHING, MATCHING), conv(MATCHING, STATE)
        self.predict = conv(STATE, OUTPUTS)

    def forward(self, frames, maps, flow, state):
        first, second = maps
        seen = evidence(*frames, flow)[1]
        around = windows(first, second, flow, self.radius)
        x = torch.cat([around, first, first - warp(second, flow), seen, flow, state], 1)
        state = leaky(self.conv3(leaky(self.conv2(leaky(self.conv1(x))))))
        predicted = self.predict(state)
        return changed(flow, seen, predicted), predicted[:, 2:], state


class Refinement(nn.Module):
    def __init__(self):
        super().__init__()
        fine, middle, coarse = WIDTHS
        self.enter = conv(24 + EVIDENCE + 2 + STATE, fine)
        self.down = nn.ModuleList([Step(fine, middle), Step(middle, coarse)])
        self.up = nn.ModuleList([conv(coarse + middle, middle), conv(middle + fine, fine)])
        self.state, self.predict = conv(fine, STATE), conv(STATE, OUTPUTS)

    def forward(self, frames, flow, state):
        first, _ = frames
        warped, seen = evidence(*frames, flow)
        fine = leaky(self.enter(torch.cat([cells(first), cells(4 * (first - warped)), seen, flow, state], 1)))
        middle = self.down[0](fine)
        coarse = self.down[1](middle)
        middle = leaky(self.up[0](torch.cat([twice(coarse), middle], 1)))
        fine = leaky(self.up[1](torch.cat([twice(middle), fine], 1)))
        state = leaky(self.state(fine))
        predicted = self.predict(state)
        return changed(flow, seen, predicted), predicted[:, 2:], state


class SrFlow(nn.Module):
    def __init__(self):
        super().__init__()
        self.iters = 2
        inputs = (3, *CHANNELS)
        self.pyramid = nn.ModuleList(Step(inputs[i], channels) for i, channels in enumerate(CHANNELS))
        self.matchings = nn.ModuleList(
            Matching(radius, channels) for radius, channels in zip(RADII, CHANNELS[1:], strict=True)
        )
        self.refinement = Refinement()
        self.mask = conv(STATE, 36)

    def maps(self, frame):
        maps = []
        for step in self.pyramid:
            frame = step(frame)
            maps.append(frame)
        return maps[1:]

    def forward(self, inputs):
        images = 2 * inputs["images"].flip(2) - 1
        height, width = images.shape[3:]
        lacking = [-height % STRIDES[-1], -width % STRIDES[-1]]
        top, left = lacking[0] // 2, lacking[1] // 2
        around = (left, lacking[1] - left, top, lacking[0] - top)
        frames = [F.pad(images[:, i], around, mode="replicate") for i in (0, 1)]
        size = frames[0].shape[2:]
        smaller = [frames]
        for _ in STRIDES:
            smaller.append([F.avg_pool2d(frame, 2) for frame in smaller[-1]])
        maps = [self.maps(frame) for frame in frames]
        coarsest = [side // STRIDES[-1] for side in size]
        flow, state = (torch.zeros(len(images), channels, *coarsest) for channels in (2, STATE))
        flows, mixtures = [], []

        def add(flow, mixture):
            inside = (slice(None), slice(None), slice(top, top + height), slice(left, left + width))
            flows.append(flow[inside])
            mixtures.append(resized(mixture, size)[inside])

        for level in reversed(range(len(STRIDES))):
            found = self.matchings[level](smaller[level + 1], (maps[0][level], maps[1][level]), flow, state)
            flow, mixture, state = found
            add(resized_flow(flow, size), mixture)
            finer = [2 * side // STRIDES[level] for side in size]
            flow, state = resized_flow(flow.detach(), finer), twice(state)
        for _ in range(self.iters):
            flow, mixture, state = self.refinement(frames, flow, state)
            add(convex_upsample(flow, self.mask(state)), mixture)
            flow = flow.detach()
        return {"flows": flows[-1][:, None], "flow_preds": flows, "info_preds": mixtures}
