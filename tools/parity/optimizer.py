"""Golden values of AdamW, gradient clipping and the one-cycle schedule, by PyTorch.

    python tools/parity/optimizer.py > crates/train/tests/golden/optimizer.json

Made with PyTorch 2.11. `crates/train/tests/train/optimizer.rs` computes the same parameters and gradients.
"""

import json

import torch

STEPS = 12
SIZES = [7, 40]


def number(i, seed):
    """In -1..1, exact in single precision."""
    return ((i * 7919 + seed * 104729) % 2048) / 1024 - 1


def tensor(size, seed):
    return torch.tensor([number(i, seed) for i in range(size)], dtype=torch.float32)


def schedule(peak, total, pct_start, steps):
    optimizer = torch.optim.AdamW([torch.nn.Parameter(torch.zeros(1))], lr=peak)
    one_cycle = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, peak, total, pct_start=pct_start, cycle_momentum=False, anneal_strategy="linear"
    )
    rates = []
    for step in range(max(steps) + 1):
        if step in steps:
            rates.append([step, one_cycle.get_last_lr()[0]])
        optimizer.step()
        one_cycle.step()
    return {"peak": peak, "total": total, "pct_start": pct_start, "rates": rates}


def train():
    parameters = [torch.nn.Parameter(tensor(size, 3 + i)) for i, size in enumerate(SIZES)]
    unused = torch.nn.Parameter(tensor(3, 9))
    optimizer = torch.optim.AdamW([*parameters, unused], lr=1e-2, weight_decay=1e-2, eps=1e-8)
    one_cycle = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, 1e-2, 20, pct_start=0.3, cycle_momentum=False, anneal_strategy="linear"
    )
    norms, states = [], []
    for step in range(STEPS):
        for i, parameter in enumerate(parameters):
            # The first steps are clipped, the last are not.
            parameter.grad = tensor(SIZES[i], 100 + 10 * step + i) * 0.5 ** (step // 2)
        norms.append(torch.nn.utils.clip_grad_norm_(parameters, 1.0).item())
        optimizer.step()
        one_cycle.step()
        if step in (0, STEPS - 1):
            states.append([parameter.tolist() for parameter in [*parameters, unused]])
    return {"norms": norms, "states": states}


print(
    json.dumps(
        {
            "schedules": [
                schedule(1.25e-4, 38260, 0.05, [0, 1, 500, 1911, 1912, 1913, 20000, 38159, 38259]),
                schedule(4e-4, 120, 0.05, [0, 1, 4, 5, 6, 7, 60, 119]),
                schedule(1e-3, 101, 0.05, [0, 4, 5, 100]),
            ],
            "training": train(),
        },
        indent=1,
    )
)
