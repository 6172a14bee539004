"""Loads what `srflow models export` wrote with PyTorch and ptlflow, and compares the numbers to the bit:

    pip install ptlflow==0.4.2
    srflow models export WEIGHTS -o x.ckpt
    srflow models export WEIGHTS -o x.safetensors
    python tools/parity/pytorch_export.py raft x.ckpt x.safetensors

The first argument is ptlflow's name of the network, such as raft_small.
"""

import json
import struct
import sys

import ptlflow
import torch


def safetensors(path):
    with open(path, "rb") as file:
        (length,) = struct.unpack("<Q", file.read(8))
        table = json.loads(file.read(length))
        numbers = file.read()
    for name, info in table.items():
        if name != "__metadata__":
            start, end = info["data_offsets"]
            values = torch.frombuffer(bytearray(numbers[start:end]), dtype=torch.float32)
            yield name, values.reshape(info["shape"])


name, checkpoint_path, safetensors_path = sys.argv[1:]
prefix = "network." if name == "memflow" else ""
for mmap in (False, True):
    checkpoint = torch.load(checkpoint_path, map_location="cpu", weights_only=True, mmap=mmap)
    state = checkpoint["state_dict"]
    for key, expected in safetensors(safetensors_path):
        assert torch.equal(state[prefix + key].view(torch.int32), expected.view(torch.int32)), key

fresh = ptlflow.get_model(name)
network = ptlflow.get_model(name, ckpt_path=checkpoint_path)  # load_state_dict with strict=True
for key, value in network.state_dict().items():
    assert torch.equal(value, state[key]), key
    if not value.is_floating_point():
        # Counters and tables of indices, which are not learned.
        assert torch.equal(value, fresh.state_dict()[key]), key
type(network).load_from_checkpoint(checkpoint_path, map_location="cpu", weights_only=True)
print(f"{name}: {len(state)} tensors, the same to the bit in PyTorch {torch.__version__} and ptlflow's {name}")
