"""FlowNet3's stack of three small networks ("css" of https://github.com/lmb-freiburg/netdef_models) in PyTorch.

Ilg et al., Occlusions, Motion and Depth Boundaries with a Generic Network for Disparity, Optical Flow or Scene Flow, ECCV 2018.
The authors' program needs TensorFlow 1.4 and their own operations on a GPU; this follows what that program computes. Takes and
gives what ptlflow's models do, and the probability of occlusion beside: see tools/parity/nets.py.
"""

import torch
import torch.nn.functional as F
from torch import nn

MEAN = 0.4
MULTIPLE = 64
# Of the channels of FlowNet.
FACTOR = 0.375
RADIUS, SPACING = 10, 2


def channels(of_flownet):
    return int(FACTOR * of_flownet)


def conv(inputs, outputs, kernel, stride=1):
    return nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2)


def leaky(x):
    return F.leaky_relu(x, 0.1)


def enlarged(x, size):
    """Edges on edges, without a gradient: the reference's own resampling has none."""
    return F.interpolate(x, size, mode="bilinear", align_corners=False).detach()


def first_on_first(x, size):
    """TensorFlow 1's resize_images: pixel i lies at i * old / new of the old pixels."""
    for axis, new in zip((2, 3), size):
        old = x.shape[axis]
        place = torch.arange(new, dtype=torch.float64) * old / new
        lower = place.floor().long()
        upper = (lower + 1).clamp(max=old - 1)
        shape = [1] * 4
        shape[axis] = new
        fraction = (place - lower).float().reshape(shape)
        x = x.index_select(axis, lower) * (1 - fraction) + x.index_select(axis, upper) * fraction
    return x


def correlation(a, b):
    """Mean over the channels of products with each second pixel around, rows of the window first."""
    height, width = a.shape[2:]
    reach = RADIUS * SPACING
    b = F.pad(b, (reach, reach, reach, reach))
    shifts = [(y, x) for y in range(0, 2 * reach + 1, SPACING) for x in range(0, 2 * reach + 1, SPACING)]
    products = [(a * b[:, :, y : y + height, x : x + width]).mean(1, keepdim=True) for y, x in shifts]
    return torch.cat(products, 1)


def warp(image, flow):
    """Zero where a pixel leaves the image; past the last row or column, up to where the next would be, that one counts."""
    batch, count, height, width = image.shape
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    x, y = x + flow[:, 0], y + flow[:, 1]
    inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
    left, top = (x.floor() * inside).long(), (y.floor() * inside).long()
    right, bottom = (left + 1).clamp(max=width - 1), (top + 1).clamp(max=height - 1)
    pixels = image.reshape(batch, count, -1)

    def at(row, column):
        index = (row * width + column).reshape(batch, 1, -1).expand(-1, count, -1)
        return pixels.gather(2, index).reshape(image.shape)

    a, b = (x - left).unsqueeze(1), (y - top).unsqueeze(1)
    upper = (1 - a) * at(top, left) + a * at(top, right)
    lower = (1 - a) * at(bottom, left) + a * at(bottom, right)
    return ((1 - b) * upper + b * lower) * inside.unsqueeze(1)


class Features(nn.Module):
    def __init__(self, inputs):
        super().__init__()
        self.conv1 = conv(inputs, channels(64), 7, 2)
        self.conv2 = conv(channels(64), channels(128), 5, 2)
        self.conv3 = conv(channels(128), channels(256), 5, 2)

    def forward(self, x):
        map1 = leaky(self.conv1(x))
        map2 = leaky(self.conv2(map1))
        return map1, map2, leaky(self.conv3(map2))


class Encoder(nn.Module):
    def __init__(self, correlating, outputs):
        super().__init__()
        if correlating:
            self.conv_redir = conv(channels(256), channels(32), 1)
        self.conv3_1 = conv(channels(32) + (2 * RADIUS + 1) ** 2 if correlating else channels(256), channels(256), 3)
        self.conv4 = conv(channels(256), channels(512), 3, 2)
        self.conv4_1 = conv(channels(512), channels(512), 3)
        self.conv5 = conv(channels(512), channels(512), 3, 2)
        self.conv5_1 = conv(channels(512), channels(512), 3)
        self.conv6 = conv(channels(512), channels(1024), 3, 2)
        self.conv6_1 = conv(channels(1024), channels(1024), 3)
        self.predict = conv(channels(1024), outputs, 3)

    def forward(self, x):
        map3 = leaky(self.conv3_1(x))
        map4 = leaky(self.conv4_1(leaky(self.conv4(map3))))
        map5 = leaky(self.conv5_1(leaky(self.conv5(map4))))
        map6 = leaky(self.conv6_1(leaky(self.conv6(map5))))
        return map3, map4, map5, map6


class Refine(nn.Module):
    def __init__(self, inputs, features, width, outputs):
        super().__init__()
        self.deconv = nn.ConvTranspose2d(inputs, width, 4, 2, 1)
        self.predict = conv(features + width + outputs, outputs, 3)

    def forward(self, x, features, prediction):
        coarser = leaky(self.deconv(x))
        joined = torch.cat([features, coarser, enlarged(prediction, coarser.shape[2:])], 1)
        return joined, self.predict(joined)


class Decoder(nn.Module):
    def __init__(self, outputs, finest):
        super().__init__()
        inputs = channels(1024)
        features = {5: 512, 4: 512, 3: 256, 2: 128, 1: 64, 0: 16}
        widths = {5: 512, 4: 256, 3: 128, 2: 64, 1: 32, 0: 16}
        self.levels = range(5, finest - 1, -1)
        for level in self.levels:
            feature, width = channels(features[level]), channels(widths[level])
            self.add_module(f"refine_{level}", Refine(inputs, feature, width, outputs))
            inputs = feature + width + outputs
        if finest == 0:
            self.conv_edges = conv(3, channels(16), 3)


class Net(nn.Module):
    """FlowNetC of two images, or FlowNetS of what stands in for them."""

    def __init__(self, inputs, outputs, correlating, finest):
        super().__init__()
        self.features = Features(inputs)
        self.encoder = Encoder(correlating, outputs)
        self.decoder = Decoder(outputs, finest)
        self.correlating = correlating

    def forward(self, first, second=None):
        """All predictions, the coarsest first. `second` is the second image, or the first for the finest level."""
        map1, map2, joined = self.features(first)
        if self.correlating:
            products = F.relu(correlation(joined, self.features(second)[2]))
            joined = torch.cat([leaky(self.encoder.conv_redir(joined)), products], 1)
        map3, map4, map5, x = self.encoder(joined)
        prediction = self.encoder.predict(x)
        predictions = [prediction]
        maps = {5: map5, 4: map4, 3: map3, 2: map2, 1: map1}
        for level in self.decoder.levels:
            features = maps[level] if level else leaky(self.decoder.conv_edges(second))
            x, prediction = self.decoder.get_submodule(f"refine_{level}")(x, features, prediction)
            predictions.append(prediction)
        return predictions


class FlowNet3(nn.Module):
    def __init__(self):
        super().__init__()
        seen = 3 + 3 + 2 + 3 + 2
        self.net1 = Net(3, 4, True, 2)
        self.net2 = Net(seen, 4, False, 2)
        # Also of motion boundaries.
        self.net3 = Net(seen, 6, False, 0)

    def forward(self, inputs):
        images = inputs["images"].flip(2) - MEAN
        height, width = images.shape[3:]
        size = [-(-side // MULTIPLE) * MULTIPLE for side in (height, width)]
        first, second = (F.interpolate(images[:, i], size, mode="bilinear") for i in (0, 1))

        def in_frame(x):
            return F.interpolate(x, (height, width), mode="bilinear", antialias=True)

        def finished(flow):
            full = in_frame(F.interpolate(flow, size, mode="bilinear"))
            return full * torch.tensor([width / size[1], height / size[0]]).reshape(1, 2, 1, 1)

        found = [(x[:, :2], x[:, 2:4]) for x in self.net1(first, second)]
        flows = [finished(flow) for flow, _ in found]
        for net in (self.net2, self.net3):
            flow, occlusion = found[-1]
            full = first_on_first(flow, size)
            occlusion = enlarged(occlusion, size).softmax(1).detach()
            seen = torch.cat([first, second, 0.05 * full, warp(second, full), occlusion], 1)
            found = [
                (x[:, :2] + enlarged(flow, x.shape[2:]), x[:, 2:4] + enlarged(occlusion, x.shape[2:]))
                for x in net(seen, first)
            ]
            flows += [finished(flow) for flow, _ in found]
        occlusion = in_frame(found[-1][1]).softmax(1)[:, 1:]
        return {"flows": flows[-1][:, None], "flow_preds": flows, "occlusion": occlusion}
