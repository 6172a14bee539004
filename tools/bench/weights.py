#!/usr/bin/env python3
"""Full-size checkpoints of every network with random weights, in each form that people publish them.

    pip install ptlflow==0.4.2 safetensors
    python3 tools/bench/weights.py weights [--networks raft gma skflow raft_small]

Writes for each network, under its name in srflow:

    NAME.pth            zip, every name behind `module.`, as the authors of RAFT, GMA and SKFlow publish (DataParallel)
    NAME-legacy.pth     the same as torch.save wrote it before 1.6
    NAME.ckpt           Lightning's, with optimizer state and hyper-parameters, as ptlflow publishes
    NAME-half.pt        16-bit numbers, plain names
    NAME.safetensors

A flow by such weights means nothing, but it takes the time and the memory of a real one, and each of a network's files gives
the same flow (that of 16 bits nearly). For `--weights` wherever documents name a file that is not there.
"""

import argparse
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "parity"))
SEED = 7
NETWORKS = [
    "raft", "raft_small", "gma", "skflow", "rpknet", "dpflow", "ccmr", "ccmr_p",
    "sea_raft_s", "sea_raft_m", "memflow", "flownets", "flownetc", "flownetcss",
    "flownet3_css", "ssa",
    "unimatch", "unimatch_sc2", "unimatch_sc2_ref6"
]


def new_model(network):
    """Of ptlflow, or one that it lacks."""
    if network == "flownet3_css":
        from flownet3 import FlowNet3

        return FlowNet3()
    if network == "ssa":
        from ssa import Ssa

        return Ssa()
    import ptlflow

    return ptlflow.get_model(network)


def random_state(network):
    """The state_dict of a new network under ptlflow's name, always the same."""
    import torch

    torch.manual_seed(SEED)
    return new_model(network).state_dict()


def main():
    import torch
    from safetensors.torch import save_file

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--networks", nargs="+", default=NETWORKS, help="ptlflow's names")
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    for network in args.networks:
        state = random_state(network)
        name = args.folder / network.replace("_", "-")
        parallel = {f"module.{key}": value for key, value in state.items()}
        torch.save(parallel, f"{name}.pth")
        torch.save(parallel, f"{name}-legacy.pth", _use_new_zipfile_serialization=False)
        moments = {
            number: {"step": torch.tensor(1.0), "exp_avg": torch.zeros_like(value), "exp_avg_sq": torch.zeros_like(value)}
            for number, value in enumerate(state.values())
            if value.is_floating_point()
        }
        lightning = {
            "epoch": 1,
            "global_step": 1000,
            "pytorch-lightning_version": "1.6.5",
            "state_dict": state,
            "optimizer_states": [{"state": moments, "param_groups": [{"lr": 1e-4, "params": list(moments)}]}],
            "hyper_parameters": {"lr": 1e-4, "wdecay": 1e-4, "model": network},
        }
        torch.save(lightning, f"{name}.ckpt")
        half = {key: value.half() if value.is_floating_point() else value for key, value in state.items()}
        torch.save(half, f"{name}-half.pt")
        # safetensors holds every tensor once: the second name of a shared one gets a copy.
        save_file({key: value.clone() for key, value in state.items()}, f"{name}.safetensors")
        print(name, sum(value.numel() for value in state.values()), "numbers", flush=True)


if __name__ == "__main__":
    main()
