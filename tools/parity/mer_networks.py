"""Golden values for srflow_mer's classifiers: the published architectures in PyTorch, on made-up inputs.

    pip install torch==2.11.0
    python tools/parity/mer_networks.py crates/mer/tests/golden

The networks are rewritten below from the published code: Off-TANet and Off-ApexNet of
ECNU-Cross-Innovation-Lab/PRICAI2021-Off-TANet (models/off_tanet.py with net_type "ta", models/off_apexnet.py), STSTNet of
christy1206/STSTNet (main.py), SSSNet of tvaranka/meb (meb/models/me_networks.py). Given a folder with the published files off_tanet.py,
off_apexnet.py or me_networks.py as a second argument, the networks are held to them, parameter by parameter and output by output.

Parameters and inputs are not stored: both come from rules over names, shapes and positions, which
crates/mer/tests/mer/parity.rs repeats. Dropout is off in training here: its choices come from another generator. Written for
each network, as safetensors:
    evaluation      scores in evaluation, [5, 3]
    training        scores in training (batch statistics), [5, 3]
    loss            cross-entropy of `training`, [1]
    gradient.NAME   gradient of the loss by every parameter: its sum of squares, and its first value, [2]
    stepped.NAME    what three steps of Adam and StepLR(1, 0.3) add to every parameter, over the learning rate, and to
                    every running statistic, likewise [2]

The bias of a convolution right before a batch norm has no gradient but for rounding, which Adam would blow up to whole
steps; it is kept out of the steps. Beside them `ststnet.pth`, STSTNet's parameters in the form in which it is published.
"""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import torch
from golden import name_hash, noise, write_safetensors
from torch import nn
from torch.nn import functional as F

LEARNING_RATE = 6.5e-4


class Residual(nn.Module):
    def __init__(self, inputs, outputs):
        super().__init__()
        conv = lambda a, b: [nn.Conv2d(a, b, 3, padding=1), nn.BatchNorm2d(b), nn.ReLU()]
        self.conv = nn.Sequential(*conv(inputs, outputs), *conv(outputs, outputs))
        self.botneck = nn.Conv2d(inputs, outputs, 1)

    def forward(self, x):
        return F.max_pool2d(self.botneck(x) + self.conv(x), 2)


class SelfAttention(nn.Module):
    def __init__(self, inputs, outputs, side):
        super().__init__()
        self.w_q, self.w_k, self.w_v = (nn.Conv2d(inputs, outputs, 1) for _ in range(3))
        code = [[np.sin, np.cos][i % 2](1 / 10000 ** (i // 2 / side)) for i in range(side)]
        code = torch.from_numpy(np.array([code])).float()
        self.positions = code + code.t()

    def forward(self, x):
        q, k, v = self.w_q(x), self.w_k(x), self.w_v(x)
        positions = self.positions.expand_as(q)
        attention = q @ k.transpose(2, 3) + q @ positions.transpose(2, 3)
        return attention.flatten(2).softmax(dim=2).view_as(v) * v


class MultiHeadSelfAttention(nn.Module):
    def __init__(self, channels, heads, side):
        super().__init__()
        self.sa_blocks = nn.ModuleList(SelfAttention(channels, channels // heads, side) for _ in range(heads))

    def forward(self, x):
        return torch.cat([block(x) for block in self.sa_blocks], dim=1)


class ChannelAttention(nn.Module):
    def __init__(self, channels):
        super().__init__()
        self.fc1 = nn.Conv2d(channels, 1, 1, bias=False)
        self.fc2 = nn.Conv2d(1, channels, 1, bias=False)

    def forward(self, x):
        through = lambda x: self.fc2(F.relu(self.fc1(x)))
        return torch.sigmoid(through(F.adaptive_avg_pool2d(x, 1)) + through(F.adaptive_max_pool2d(x, 1)))


class SpatialAttention(nn.Module):
    def __init__(self):
        super().__init__()
        self.conv1 = nn.Conv2d(2, 1, 3, padding=1, bias=False)

    def forward(self, x):
        return torch.sigmoid(self.conv1(torch.cat([x.mean(1, keepdim=True), x.amax(1, keepdim=True)], dim=1)))


class EnhancedResidual(nn.Module):
    def __init__(self, inputs, outputs, side):
        super().__init__()
        conv = lambda a, b: nn.Sequential(nn.Conv2d(a, b, 3, padding=1), nn.BatchNorm2d(b), nn.ReLU())
        self.conv1, self.conv2 = conv(inputs, inputs), conv(inputs, outputs)
        self.botneck = nn.Conv2d(inputs, outputs, 1)
        self.spa, self.ca = SpatialAttention(), ChannelAttention(inputs)
        self.sa = MultiHeadSelfAttention(inputs, 4, side)

    def forward(self, x):
        shortcut = self.botneck(x)
        x = self.conv1(x)
        x = self.ca(x) * x
        x = self.spa(x) * x
        return F.max_pool2d(self.conv2(self.sa(x)) + shortcut, 2)


def dense(inputs, hidden):
    hidden_layer = lambda a, b: [nn.Linear(a, b), nn.ReLU(), nn.Dropout(0.5)]
    return nn.Sequential(*hidden_layer(inputs, hidden), *hidden_layer(hidden, hidden), nn.Linear(hidden, 3))


class OffTaNet(nn.Module):
    INPUT = (3, 112, 112)

    def __init__(self):
        super().__init__()
        self.conv1 = nn.Sequential(nn.Conv2d(3, 8, 7, stride=2, padding=3), nn.ReLU(), nn.BatchNorm2d(8))
        self.res1, self.res2 = Residual(8, 18), Residual(18, 28)
        self.eres = EnhancedResidual(28, 8, 14)
        self.dense = dense(392, 64)

    def forward(self, x):
        return self.dense(self.eres(self.res2(self.res1(self.conv1(x)))).flatten(1))


class StstNet(nn.Module):
    INPUT = (3, 28, 28)

    def __init__(self):
        super().__init__()
        self.conv1, self.conv2, self.conv3 = (nn.Conv2d(3, channels, 3, padding=2) for channels in (3, 5, 8))
        self.bn1, self.bn2, self.bn3 = (nn.BatchNorm2d(channels) for channels in (3, 5, 8))
        self.dropout = nn.Dropout(0.5)
        self.fc = nn.Linear(400, 3)

    def forward(self, x):
        streams = [(self.conv1, self.bn1), (self.conv2, self.bn2), (self.conv3, self.bn3)]
        x = [self.dropout(F.max_pool2d(norm(F.relu(conv(x))), 3, stride=3, padding=1)) for conv, norm in streams]
        return self.fc(F.avg_pool2d(torch.cat(x, dim=1), 2).flatten(1))


class OffApexStream(nn.Module):
    def __init__(self):
        super().__init__()
        self.conv1, self.conv2 = nn.Conv2d(1, 6, 5, padding=2), nn.Conv2d(6, 16, 5, padding=2)

    def forward(self, x):
        return F.max_pool2d(self.conv2(F.max_pool2d(self.conv1(x), 2)), 2).flatten(1)


class OffApexNet(nn.Module):
    INPUT = (2, 28, 28)

    def __init__(self):
        super().__init__()
        self.cnn1, self.cnn2 = OffApexStream(), OffApexStream()
        self.dense = dense(784 * 2, 1024)

    def forward(self, x):
        return self.dense(torch.cat([self.cnn1(x[:, :1]), self.cnn2(x[:, 1:])], dim=1))


class SssNet(nn.Module):
    INPUT = (3, 64, 64)

    def __init__(self):
        super().__init__()
        self.conv1, self.bn1 = nn.Conv2d(3, 32, 5), nn.BatchNorm2d(32)
        self.conv2, self.bn2 = nn.Conv2d(32, 64, 3), nn.BatchNorm2d(64)
        self.drop = nn.Dropout2d(0.5)
        self.fc1, self.fc = nn.Linear(5184, 256), nn.Linear(256, 3)
        self.drop3 = nn.Dropout(0.5)

    def forward(self, x):
        x = self.drop(self.bn1(F.max_pool2d(F.relu(self.conv1(x)), 3)))
        x = self.drop(self.bn2(F.max_pool2d(F.relu(self.conv2(x)), 2)))
        return self.fc(self.drop3(F.relu(self.fc1(x.flatten(1)))))


NETWORKS = {"off-tanet": OffTaNet, "ststnet": StstNet, "off-apexnet": OffApexNet, "sssnet": SssNet}
# Where the published code has each.
PUBLISHED = {
    "off-tanet": ("off_tanet.py", "OffTANet"),
    "off-apexnet": ("off_apexnet.py", "OffApexNet"),
    "sssnet": ("me_networks.py", "SSSNet"),
}
LABELS = [0, 2, 1, 0, 1]
NO_GRADIENT = ["conv.0.bias", "conv.3.bias", "eres.conv1.0.bias", "eres.conv2.0.bias"]


def parameter(name, shape):
    """Weights of variance 1 / fan_in, so that activations keep their size; the rest near what training leaves."""
    u = noise(int(np.prod(shape)), name_hash(name)).reshape(shape)
    last = name.rsplit(".", 1)[-1]
    if last == "running_var":
        return np.float32(1) + np.float32(0.5) * u
    if last == "weight" and len(shape) == 1:
        return np.float32(1) + np.float32(0.25) * u
    if last == "weight":
        return u * np.float32(np.sqrt(3.0 / np.prod(shape[1:])))
    return np.float32(0.1) * u


def filled(network):
    state = network.state_dict()
    for name, value in state.items():
        if value.dtype == torch.float32:
            state[name] = torch.from_numpy(np.ascontiguousarray(parameter(name, tuple(value.shape))))
    network.load_state_dict(state)
    for module in network.modules():
        if isinstance(module, (nn.Dropout, nn.Dropout2d)):
            module.p = 0.0
    return network


def digest(tensor):
    values = tensor.detach().double().flatten()
    return np.array([float((values**2).sum()), float(values[0])], dtype=np.float32)


def compare(name, network, inputs, folder):
    file, class_name = PUBLISHED[name]
    sys.modules.setdefault("torchstat", type(sys)("torchstat")).stat = None
    spec = importlib.util.spec_from_file_location(class_name, folder / file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    published = getattr(module, class_name)()
    shapes = lambda network: {key: tuple(value.shape) for key, value in network.state_dict().items()}
    assert shapes(published) == shapes(network), name
    filled(published)
    for mode in ("eval", "train"):
        getattr(published, mode)(), getattr(network, mode)()
        with torch.no_grad():
            difference = (published(inputs) - network(inputs)).abs().max()
        print(f"{name}, {mode}: largest difference from the published code {float(difference):.1e}")


def main(folder, published=None):
    folder.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(0)
    for name, network_class in NETWORKS.items():
        shape = (len(LABELS), *network_class.INPUT)
        inputs = torch.from_numpy(noise(int(np.prod(shape)), 7).reshape(shape))
        if published and name in PUBLISHED and (published / PUBLISHED[name][0]).exists():
            compare(name, filled(network_class()), inputs, published)
        network = filled(network_class())
        if name == "ststnet":
            torch.save(network.state_dict(), folder / "ststnet.pth")
        print(f"{name}: {sum(parameter.numel() for parameter in network.parameters())} parameters")
        out = {}
        network.eval()
        with torch.no_grad():
            out["evaluation"] = network(inputs).numpy()
        network.train()
        start = {key: value.clone() for key, value in network.state_dict().items()}
        optimizer = torch.optim.Adam(network.parameters(), lr=LEARNING_RATE)
        scheduler = torch.optim.lr_scheduler.StepLR(optimizer, step_size=1, gamma=0.3)
        for step in range(3):
            scores = network(inputs)
            loss = F.cross_entropy(scores, torch.tensor(LABELS))
            optimizer.zero_grad()
            loss.backward()
            if step == 0:
                out["training"], out["loss"] = scores.detach().numpy(), loss.detach().numpy().reshape(1)
                for key, value in network.named_parameters():
                    out[f"gradient.{key}"] = digest(value.grad)
            for key, value in network.named_parameters():
                if any(key.endswith(bias) for bias in NO_GRADIENT):
                    value.grad = None
            optimizer.step()
            scheduler.step()
        for key, value in network.state_dict().items():
            if value.dtype == torch.float32:
                unit = 1.0 if "running_" in key else LEARNING_RATE
                out[f"stepped.{key}"] = digest((value - start[key]) / unit)
        write_safetensors(folder / f"{name}.safetensors", out)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
