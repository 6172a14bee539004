"""SSA's network (https://github.com/malkaddour/Self-Supervised-Approach-for-facial-movement-based-optical-flow) in PyTorch.

Alkaddour, Tariq and Dhall, Self-Supervised Approach for Facial Movement Based Optical Flow, IEEE Transactions on Affective
Computing 2022. The authors' program needs Keras 2.3 and TensorFlow 1.14; this follows what that program computes. Takes and gives
what ptlflow's models do: see tools/parity/nets.py.
"""

import torch
import torch.nn.functional as F
from flownet3 import first_on_first, leaky
from torch import nn

MULTIPLE = 64


class Same(nn.Conv2d):
    """Padding "same" of TensorFlow: with stride 2 and even sizes one more row and column after than before."""

    def __init__(self, inputs, outputs, kernel, stride=1):
        super().__init__(inputs, outputs, kernel, stride)
        total = kernel - stride
        self.around = (total // 2, total - total // 2) * 2

    def forward(self, x):
        return super().forward(F.pad(x, self.around))


def doubled(inputs, outputs):
    return nn.ConvTranspose2d(inputs, outputs, 4, 2, 1)


class Ssa(nn.Module):
    def __init__(self):
        super().__init__()
        self.conv1 = Same(3, 64, 7, 2)
        self.conv2 = Same(64, 128, 5, 2)
        self.conv3 = Same(128, 256, 5, 2)
        self.conv_redir = Same(256, 32, 1)
        self.conv3_1 = Same(32 + 2 * 256, 256, 3)
        self.conv4 = Same(256, 512, 3, 2)
        self.conv4_1 = Same(512, 512, 3)
        self.conv5 = Same(512, 512, 3, 2)
        self.conv5_1 = Same(512, 512, 3)
        self.conv6 = Same(512, 1024, 3, 2)
        self.conv6_1 = Same(1024, 1024, 3)
        self.deconv5 = doubled(1024, 512)
        self.deconv4 = doubled(1024, 512)
        self.deconv3 = doubled(1024, 256)
        self.deconv2 = doubled(512, 128)
        self.deconv1 = doubled(258, 64)
        self.join5 = Same(1026, 1024, 1)
        self.join4 = Same(1026, 1024, 1)
        self.join3 = Same(514, 512, 1)
        self.predict6 = Same(1024, 2, 3)
        self.predict5 = Same(1024, 2, 3)
        self.predict4 = Same(1024, 2, 3)
        self.predict3 = Same(512, 2, 3)
        self.predict2 = Same(258, 2, 3)
        self.predict1 = Same(130, 2, 3)

    def tower(self, image):
        map1 = leaky(self.conv1(image))
        map2 = leaky(self.conv2(map1))
        return map1, map2, leaky(self.conv3(map2))

    def forward(self, inputs):
        images = 255 * inputs["images"].flip(2)
        height, width = images.shape[3:]
        size = [-(-side // MULTIPLE) * MULTIPLE for side in (height, width)]
        first, second = (F.interpolate(images[:, i], size, mode="bilinear") for i in (0, 1))
        map1, map2, left = self.tower(first)
        right = self.tower(second)[2]
        map3 = leaky(self.conv3_1(torch.cat([leaky(self.conv_redir(left)), left, right], 1)))
        map4 = leaky(self.conv4_1(leaky(self.conv4(map3))))
        map5 = leaky(self.conv5_1(leaky(self.conv5(map4))))
        x = F.relu(self.conv6_1(leaky(self.conv6(map5))))
        flow = self.predict6(x)
        flows = []
        for level, features in ((5, map5), (4, map4), (3, map3), (2, map2), (1, map1)):
            larger = 2 * first_on_first(flow, features.shape[2:])
            x = torch.cat([features, leaky(self.get_submodule(f"deconv{level}")(x)), larger], 1)
            if level > 2:
                x = F.relu(self.get_submodule(f"join{level}")(x))
            flow = self.get_submodule(f"predict{level}")(x)
            flows.append(flow)

        def finished(flow):
            scale = torch.tensor([width / flow.shape[3], height / flow.shape[2]]).reshape(1, 2, 1, 1)
            return F.interpolate(flow, (height, width), mode="bilinear") * scale

        # The coarsest flow is none of the reference's outputs.
        flows = [finished(flow) for flow in flows]
        return {"flows": flows[-1][:, None], "flow_preds": flows}
