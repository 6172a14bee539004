"""The network that comes with srflow (crates/nets/src/srflow.rs) in PyTorch, as its definition, but for the flow it starts from.

Takes and gives what ptlflow's models do (see tools/parity/nets.py), and the flow to start from.
"""

import torch
import torch.nn.functional as F
from torch import nn

STRIDE = 2
COARSEST_STRIDE = 32
WIDTHS = (32, 64, 96, 128, 160)
STATE = 32
SEEN_CELLS = 8.0
WORSE_FACTOR, WORSE_BY, AROUND = 1.1, 0.01, 4
OUTPUTS = 7
EVIDENCE = 8
NOISE = 1.4e-4
REACH = 2.0
DIFFERENCE_SCALE = 4


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


def cells(x):
    return F.pixel_unshuffle(x, 2)


def twice(x):
    return F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)


def convex_upsample(flow, mask):
    batch, _, height, width = flow.shape
    weights = mask.reshape(batch, 1, 9, 2, 2, height, width).softmax(dim=2)
    around = F.unfold(2 * flow, 3, padding=1).reshape(batch, 2, 9, 1, 1, height, width)
    return (weights * around).sum(2).permute(0, 1, 4, 2, 5, 3).reshape(batch, 2, 2 * height, 2 * width)


def without_lattice(flow):
    return F.avg_pool2d(F.avg_pool2d(F.pad(flow, (1, 1, 1, 1), mode="replicate"), 2, 1), 2, 1)


def in_pixels(flow):
    return resized_flow(flow, [2 * side for side in flow.shape[2:]])


def seen_flow(flow):
    return flow / (1 + (flow / SEEN_CELLS) ** 2).sqrt()


class Explained:
    """A flow in cells, and how far frame 1 is from frame 2 warped by it around each cell."""

    def __init__(self, flow, warped, residual):
        self.flow, self.warped, self.residual = flow, warped, residual

    @classmethod
    def by(cls, first, second, flow):
        warped = warp(second, in_pixels(flow))
        return cls(flow, warped, residual(first, warped))

    def or_before(self, before):
        worse = is_worse(self.residual, before.residual)
        return Explained(
            torch.where(worse, before.flow, self.flow),
            torch.where(pixels(worse), before.warped, self.warped),
            torch.minimum(self.residual, before.residual),
        )

    def or_flow(self, first, second, found):
        worse = is_worse(residual(first, warp(second, found)), self.residual)
        return torch.where(pixels(worse), in_pixels(self.flow), found)


def residual(first, warped):
    of_cells = F.avg_pool2d((first - warped).abs().mean(1, keepdim=True), 2)
    return F.avg_pool2d(of_cells, 2 * AROUND + 1, 1, AROUND, count_include_pad=False)


def is_worse(residual, before):
    return residual > WORSE_FACTOR * before + WORSE_BY


def pixels(x):
    return x.repeat_interleave(2, 2).repeat_interleave(2, 3)


class Step(nn.Module):
    def __init__(self, inputs, outputs):
        super().__init__()
        self.down, self.same = conv(inputs, outputs, 2), conv(outputs, outputs)

    def forward(self, x):
        return leaky(self.same(leaky(self.down(x))))


class SrFlow(nn.Module):
    def __init__(self):
        super().__init__()
        self.iters = 2
        levels = list(zip(WIDTHS, WIDTHS[1:]))
        self.enter = conv(12 + 4 + EVIDENCE + 12 + EVIDENCE + 2, WIDTHS[0])
        self.down = nn.ModuleList(Step(fine, coarse) for fine, coarse in levels)
        self.up = nn.ModuleList(conv(coarse + fine + 2, fine) for fine, coarse in levels)
        self.predict = nn.ModuleList(conv(channels, OUTPUTS) for channels in WIDTHS)
        self.evidence = conv(STATE, 2)
        self.mask = conv(STATE, 36)

    def corrected(self, first, second, flow, warped):
        evidence = lucas_kanade(first, warped)
        still = (first - second).mean(1, keepdim=True)
        still = [cells(first), cells(DIFFERENCE_SCALE * still), lucas_kanade(first, second)]
        frames = [*still, cells(DIFFERENCE_SCALE * (first - warped))]
        maps = [leaky(self.enter(torch.cat([*frames, evidence, seen_flow(flow)], 1)))]
        starts = [flow]
        for step in self.down:
            maps.append(step(maps[-1]))
            starts.append(F.avg_pool2d(starts[-1], 2))
        found = []
        for level in reversed(range(len(maps))):
            start = starts[level]
            if found:
                coarser = twice(flow)
                state = leaky(self.up[level](torch.cat([twice(state), maps[level], seen_flow(coarser - start)], 1)))
            else:
                coarser, state = torch.zeros_like(start), maps[level]
            predicted = self.predict[level](state)
            share, change, mixture = predicted[:, :1].tanh().relu(), predicted[:, 1:3], predicted[:, 3:]
            flow = (1 - share) * start + share * coarser + change
            found.append((flow, mixture))
        shares = self.evidence(state).tanh()
        for window in (0, 1):
            flow = flow + shares[:, window : window + 1] * evidence[:, 4 * window : 4 * window + 2] / STRIDE
        return [*found[:-1], (flow, mixture)], state

    def forward(self, inputs):
        images = 2 * inputs["images"].flip(2) - 1
        height, width = images.shape[3:]
        lacking = [-height % COARSEST_STRIDE, -width % COARSEST_STRIDE]
        top, left = lacking[0] // 2, lacking[1] // 2
        around = (left, lacking[1] - left, top, lacking[0] - top)
        first, second = (F.pad(images[:, i], around, mode="replicate") for i in (0, 1))
        size = first.shape[2:]
        inside = (slice(None), slice(None), slice(top, top + height), slice(left, left + width))
        flow = inputs["start"]
        estimates = not torch.is_grad_enabled()
        flows, mixtures, kept = [], [], None
        for _ in range(self.iters):
            explained = Explained.by(first, second, flow.detach())
            kept = explained.or_before(kept) if kept and estimates else explained
            found, state = self.corrected(first, second, kept.flow, kept.warped)
            for flow, mixture in found[:-1:2]:
                flows.append(STRIDE * resized(flow, size)[inside])
                mixtures.append(resized(mixture, size)[inside])
            flow, mixture = found[-1]
            upsampled = without_lattice(convex_upsample(flow, self.mask(state)))
            if estimates:
                upsampled = kept.or_flow(first, second, upsampled)
            flows.append(upsampled[inside])
            mixtures.append(resized(mixture, size)[inside])
        return {
            "flows": flows[-1][:, None],
            "flow_preds": flows,
            "info_preds": mixtures,
        }
