"""The rasterizer as a differentiable function of PyTorch. The main fits Gaussians to a picture of a head and to its motion.

python torch_rasterizer.py [STEPS]
"""

import sys

import torch

import srflow

NAMES = ["means", "scales", "rotations", "opacities", "sh", "means_next"]


class Rasterize(torch.autograd.Function):
    """Colour, alpha and flow of Gaussians that move to `means_next`. Tensors are in the form of `srflow.Gaussians`."""

    @staticmethod
    def forward(ctx, camera, *tensors):
        means, scales, rotations, opacities, sh, means_next = (x.detach().cpu() for x in tensors)
        rest = scales, rotations, opacities, sh
        ctx.scene = srflow.Gaussians(means, *rest), camera, srflow.Gaussians(means_next, *rest)
        frame = srflow.rasterize(*ctx.scene)
        return tuple(torch.from_numpy(frame[name]).to(tensors[0].device) for name in ["color", "alpha", "flow"])

    @staticmethod
    def backward(ctx, color, alpha, flow):
        gradients = {"color": color.cpu(), "alpha": alpha.cpu(), "flow": flow.cpu()}
        found = srflow.rasterize_backward(gradients, *ctx.scene)
        return None, *(torch.from_numpy(found[name]).to(color.device) for name in NAMES)


def main(steps=200, count=2000, side=96):
    torch.manual_seed(0)
    avatar = srflow.Avatar.builtin(7)
    rest, smile = avatar.pose(), avatar.pose({12: 0.8})
    camera = srflow.Camera.facing(rest, side, side)
    wanted = srflow.rasterize(rest, camera, next=smile)
    color, alpha, flow = (torch.from_numpy(wanted[name]) for name in ["color", "alpha", "flow"])

    # Begins with some of the head's Gaussians, larger and without their colours.
    some = torch.randperm(len(rest))[:count]
    means = torch.from_numpy(rest.means)[some].requires_grad_()
    motion = torch.zeros(count, 3, requires_grad=True)
    scales = torch.full((count, 3), 0.005).log().requires_grad_()
    rotations = torch.tensor([0.0, 0.0, 0.0, 1.0]).repeat(count, 1).requires_grad_()
    opacities = torch.zeros(count, requires_grad=True)
    sh = torch.zeros(count, 1, 3, requires_grad=True)
    optimizer = torch.optim.Adam(
        [
            {"params": [means, motion], "lr": 3e-4},
            {"params": [scales, rotations, opacities, sh], "lr": 3e-2},
        ]
    )
    losses = []
    for step in range(steps):
        shown, opacity, moved = Rasterize.apply(
            camera, means, scales.exp(), rotations, opacities.sigmoid(), sh, means + motion
        )
        loss = (shown - color).abs().mean() + (opacity - alpha).abs().mean() + 0.1 * (moved - flow).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
        if step % 20 == 0 or step == steps - 1:
            print(f"step {step:4}  loss {losses[-1]:.4f}")
    return losses


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
