"""Golden values of a convolution with batch norm in training, by PyTorch.

    python tools/parity/batch_norm.py

Made with PyTorch 2.11. Printed are the arrays of the test in crates/nn/src/layers/batch_norm.rs.
"""

import torch


def numbers(shape, seed):
    """In -1..1, exact in single precision."""
    count = torch.Size(shape).numel()
    values = [((i * 7919 + seed * 104729) % 2048) / 1024 - 1 for i in range(count)]
    return torch.tensor(values, dtype=torch.float32).reshape(shape)


conv = torch.nn.Conv2d(2, 3, 1)
norm = torch.nn.BatchNorm2d(3)
with torch.no_grad():
    conv.weight.copy_(numbers([3, 2, 1, 1], 1))
    conv.bias.copy_(numbers([3], 2))
    norm.weight.copy_(numbers([3], 3))
    norm.bias.copy_(numbers([3], 4))
outs = []
for seed in (5, 6):
    x = numbers([2, 2, 3, 4], seed).requires_grad_()
    out = torch.relu(norm(conv(x)))
    outs.append(out)
(outs[-1] * numbers([2, 3, 3, 4], 7)).sum().backward()


def literal(name, tensor):
    print(f"const {name}: [f32; {tensor.numel()}] = {[round(v, 6) for v in tensor.flatten().tolist()]};")


literal("OUT", outs[-1][:, :, 1, 2])
literal("MEAN", norm.running_mean)
literal("VARIANCE", norm.running_var)
literal("X_GRADIENT", x.grad[:, :, 1, 2])
literal("CONV_GRADIENT", conv.weight.grad)
literal("WEIGHT_GRADIENT", norm.weight.grad)
