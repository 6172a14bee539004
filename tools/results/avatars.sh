#!/usr/bin/env bash
# docs/explanation/results.md: The flow of a trained avatar is off by 0.05 to 0.07 px, if its mesh is right. Writes into the current folder.
set -euo pipefail
srflow avatar capture --head builtin --look 1 --seed 1 --timesteps 60 --landmark-noise 1 --out builtin
srflow avatar fit builtin --model builtin-average --truth builtin --out builtin-fit
srflow avatar train builtin-fit --config cpu --out runs/builtin-fit
srflow avatar eval runs/builtin-fit builtin-fit --flow --truth builtin --limit 60
