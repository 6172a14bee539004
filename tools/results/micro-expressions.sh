#!/usr/bin/env bash
# docs/explanation/results.md: Micro-expressions. Writes into the current folder.
#
#   tools/results/micro-expressions.sh [LOOK]     # of the heads; 1 by default
#
set -euo pipefail
look=${1:-1}
synth="srflow mer synth --look $look --subjects 8 --clips 12 --side 192 --fps 60 --noise 2 --drift 2 --lighting 2 --only-key-frames"
for intensity in 0.25 0.15; do
    for seed in 1 2 3 4 5; do
        $synth --intensity $intensity --seed $seed --out "set-$intensity-$seed"
        srflow mer run --data "clips:set-$intensity-$seed" --only-key-frames --method srflow tvl1 farneback \
            --cache features --out "results-$intensity-$seed"
        srflow mer run --data "clips:set-$intensity-$seed" --only-key-frames --method srflow tvl1 farneback \
            --cache features --augment mirror-rotate --out "augmented-$intensity-$seed"
    done
    # The sets as one: subjects of different sets are different people.
    for run in results augmented; do
        awk -F, -v OFS=, 'NR == 1 { print } FNR > 1 { $2 = "five sets"; print }' $run-$intensity-*/predictions.csv > "$run-$intensity.csv"
        srflow mer tables "$run-$intensity.csv" --out "tables-$run-$intensity"
    done
done
for seed in 1 2 3; do
    srflow mer run --data "clips:set-0.25-$seed" --only-key-frames --cache features --classifier sssnet --epochs 101 --seeds 2 \
        --out "sssnet-$seed"
done
# The paper's protocol, with three seeds of training.
srflow mer synth --look $look --out paper-set --subjects 8 --clips 12 --side 192 --fps 60 --noise 2 --drift 2 --lighting 2 --intensity 0.25 --seed 7
for seed in 1 2 3; do
    srflow mer run --data clips:paper-set --protocol paper --seed $seed --iters 4 --method farneback srflow tvl1 --out "paper-$seed"
done
