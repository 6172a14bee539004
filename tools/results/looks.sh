#!/usr/bin/env bash
# docs/explanation/results.md: whether training on the second look of heads helps. Writes into the current folder.
set -euo pipefail
settings='--config srflow --crop 224x224 --batch 2 --set augmentation.log2_scale=[-0.3,0.7] --set training.rising=0.03
    --set validation.every=100000 --set validation.limit=10'
srflow shapes --out shapes --pairs 2400 --size 384x320 --seed 11
for look in 1 2; do
    srflow render --look $look --preset wild --scenes 48 --frames 8 --size 275x401 --seed 21 --splits 0.9,0.1,0 --out faces-$look
    srflow mer synth --look $look --only-key-frames --side 192 --subjects 16 --clips 6 --intensity 0.4 --seed 31 --out weak-$look
done
srflow train $settings --data chairs:shapes --steps 1500 --learning-rate 5e-4 --out start
for seed in 1 2 3; do
    for look in 1 2; do
        srflow train $settings --data "srflow:faces-$look" --data "clips:weak-$look@all" --weights start/last.safetensors \
            --steps 600 --learning-rate 2e-4 --seed $seed --set loss.strain=0.25 --out run-$look-$seed
    done
done
