#!/usr/bin/env bash
# docs/explanation/avatars.md: Photometric alignment. Writes into the current folder, one JSON a fit.
set -euo pipefail
for seed in 1 2; do
  srflow avatar capture --head builtin --seed $seed --cameras 1 --timesteps 120 --size 640x360 --background '#707880' \
    --noise 1 --landmark-noise 1 --out capture-$seed
  for how in '' --photometric; do
    srflow avatar fit capture-$seed --model builtin-average --truth capture-$seed $how --out fit-$seed$how --json > fit-$seed$how.json
  done
done
