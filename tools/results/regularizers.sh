#!/usr/bin/env bash
# docs/explanation/results.md: Faces help, not just more training; the regularizers change little. Writes into the current folder.
set -euo pipefail
srflow shapes --out shapes --pairs 2400 --size 384x320 --seed 11
srflow render --look 1 --preset wild --scenes 48 --frames 10 --size 275x401 --seed 21 --splits 0.7,0.05,0.25 --out faces
settings='--config srflow --crop 224x224 --batch 2 --set augmentation.log2_scale=[-0.3,0.7] --set training.rising=0.03'
srflow train $settings --data chairs:shapes --steps 1500 --learning-rate 5e-4 --out start
srflow ablation $settings --data srflow:faces --control chairs:shapes --weights start/last.safetensors --steps 150 \
  --learning-rate 2e-4 --set validation.every=100000 --set validation.limit=60 --test srflow:faces@test --test chairs:shapes@val --out runs
