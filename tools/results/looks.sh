#!/usr/bin/env bash
# docs/explanation/results.md: whether a network learns more from the second look of heads. Writes into the current folder.
#
#   tools/results/looks.sh raft-small.pth     # the authors' weights
#
set -euo pipefail
for look in 1 2; do
    srflow render --look $look --preset wild --scenes 48 --frames 8 --size 275x401 --seed 21 --splits 0.9,0.1,0 --out faces-$look
    srflow mer synth --look $look --only-key-frames --side 192 --subjects 16 --clips 6 --intensity 0.4 --seed 31 --out weak-$look
done
for seed in 1 2 3; do
    for look in 1 2; do
        srflow train --config finetune --network raft-small --weights "$1" --data "srflow:faces-$look" --data "clips:weak-$look@all" \
            --crop 224x224 --batch 2 --iterations 8 --steps 300 --learning-rate 1e-4 --seed $seed --set loss.strain=0.25 \
            --set augmentation.log2_scale=[-0.3,0.7] --set training.rising=0.03 --set validation.every=100000 \
            --set validation.limit=10 --out run-$look-$seed
    done
done
