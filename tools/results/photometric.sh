#!/usr/bin/env bash
# docs/explanation/avatars.md: Photometric alignment. Needs MediaPipe's networks (SRFLOW_FACE_MODELS). Writes into the current folder, one
# JSON a fit.
set -euo pipefail
for seed in 1 2; do
  srflow avatar capture --head builtin --seed $seed --cameras 1 --timesteps 120 --size 640x360 --background '#707880' \
    --noise 1 --landmark-noise 1 --out capture-$seed
  srflow face capture-$seed/images -o mediapipe-$seed.csv
  for how in '' --photometric; do
    srflow avatar fit capture-$seed --model builtin-average --truth capture-$seed $how \
      --out fit-$seed$how --json > fit-$seed$how.json
    srflow avatar fit capture-$seed --model builtin-average --truth capture-$seed $how --landmarks-of 8=mediapipe-$seed.csv \
      --out mediapipe-$seed$how --json > mediapipe-$seed$how.json
  done
done
