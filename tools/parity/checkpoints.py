"""Small checkpoints in every form that PyTorch saves: python tools/parity/checkpoints.py crates/nn/tests/checkpoints

The names are those of a block of RAFT's context encoder, whose shortcut's norm is stored twice.
"""

import sys
import types
from collections import OrderedDict, defaultdict, deque
from pathlib import Path

import numpy as np
import torch
from torch import nn


class Block(nn.Module):
    def __init__(self):
        super().__init__()
        self.conv1 = nn.Conv2d(2, 3, 3)
        self.norm3 = nn.BatchNorm2d(3)
        self.downsample = nn.Sequential(nn.Conv2d(2, 3, 1), self.norm3)


folder = Path(sys.argv[1])
folder.mkdir(parents=True, exist_ok=True)
state = Block().state_dict()
for number, name in enumerate(sorted(state)):
    if state[name].dtype == torch.float32:
        # The two copies of the norm get the same values: both names hold the same tensor.
        values = torch.arange(state[name].numel(), dtype=torch.float32) / 8 + number
        state[name].copy_(values.reshape(state[name].shape))

prefixed = {f"module.{name}": value for name, value in state.items()}
torch.save(prefixed, folder / "zip.pth")
torch.save(prefixed, folder / "legacy.pth", _use_new_zipfile_serialization=False)
half = {name: value.half() if value.is_floating_point() else value for name, value in state.items()}
torch.save(half, folder / "half.pt")
# The name of a hyper-parameter among other texts: where it is a key, the pickle refers to the text that was written before.
lightning = {
    "train_avg_length": 1,
    "epoch": 3,
    "state_dict": {f"network.{name}": value for name, value in state.items()},
    "optimizer_states": [{"state": {0: {"exp_avg": torch.ones(4)}}}],
    "hyper_parameters": {
        "critical_params": ("corr_levels", "train_avg_length"),
        "lr": 1e-4,
        "pretrain": True,
        "corr_levels": 4,
        "gamma": -0.5,
        "top_k": None,
        "iters": [8, 10],
        "train_avg_length": 6624.0,
        "num_steps": 120000,
        "offset": -3,
        "count": 1 << 40,
    },
}
torch.save(lightning, folder / "lightning.ckpt")
# A kilobyte that claims a gigabyte: one number, repeated by a stride of zero.
torch.save({"conv1.weight": torch.zeros(1).expand(1 << 28)}, folder / "expanded.pth")


# What else programs put beside the weights.
class Settings(dict):
    """As easydict.EasyDict and yacs.config.CfgNode."""


class Names(list):
    pass


for container, module in [(Settings, "easydict"), (Names, "names")]:
    container.__module__ = module
    sys.modules[module] = types.ModuleType(module)
    setattr(sys.modules[module], container.__name__, container)
settings = Settings(corr_levels=4, inner=Settings(iters=12))
settings.corr_levels = 4
beside = {
    "config": settings,
    "history": defaultdict(list, loss=[1.0, 0.5]),
    "last": deque([1, 2], maxlen=5),
    "order": OrderedDict(a=1),
    "names": Names(["a", "b"]),
    "device": torch.device("cpu"),
    "type": torch.float16,
    "size": torch.Size([2, 3]),
    "set": {1, 2},
}
torch.save({"model": OrderedDict(state), **beside}, folder / "beside.pth")
# Arrays of other kinds alone.
arrays = {
    "a": np.arange(3, dtype=np.float32),
    "b": np.float32(1.5),
    "c": torch.zeros(2).to(torch.float8_e4m3fn),
    "d": torch.zeros(2, dtype=torch.int64),
    "e": torch.zeros(2, device="meta"),
}
torch.save(arrays, folder / "arrays.pth")
module = Block()
module.load_state_dict(state)
torch.jit.script(module).save(folder / "script.pt")
module.register_buffer("cache", torch.zeros(2), persistent=False)
torch.save(module, folder / "module.pt")
torch.serialization.set_crc32_options(False)
torch.save(prefixed, folder / "without-checksums.pth")
