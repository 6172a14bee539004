#!/usr/bin/env bash
# docs/explanation/results.md: The second look of heads helps on its own clips. Writes into the current folder.
#
#   tools/results/looks.sh RAFT_SMALL FACEXMODEL LAM PHOTOGRAPH...     # RAFT_SMALL: the authors' weights
#
set -euo pipefail
tools=$(cd "$(dirname "$0")" && pwd)
weights=$1 ict=$2 lam=$3
shift 3
for look in 1 2; do
    srflow render --look $look --preset wild --scenes 48 --frames 8 --size 275x401 --seed 21 --splits 0.9,0.1,0 --out faces-$look
    srflow mer synth --look $look --only-key-frames --side 192 --subjects 16 --clips 6 --intensity 0.4 --seed 31 --out weak-$look
done
for seed in 1 2 3; do
    for look in 1 2; do
        srflow train --config finetune --network raft-small --weights "$weights" --data "srflow:faces-$look" --data "clips:weak-$look@all" \
            --crop 224x224 --batch 2 --iterations 8 --steps 300 --learning-rate 1e-4 --seed $seed --set loss.strain=0.25 \
            --set augmentation.log2_scale=[-0.3,0.7] --set training.rising=0.03 --set validation.every=100000 \
            --set validation.limit=10 --out run-$look-$seed
    done
done

python "$tools/face_network.py" sets tests --heads "ict=ict:$ict" "lam=lam:$lam" --faces "$@"
python "$tools/face_network.py" sets tests-1 --look 1
for tests in tests tests-1; do
    for run in 1-1 1-2 1-3 2-1 2-2 2-3; do
        python "$tools/face_network.py" score $tests $run -- --method "raft-small=run-$run/last.safetensors" --iters 12
    done
    for score in head strain_correlation expression; do
        python "$tools/face_network.py" change $tests --score $score --before 1-1 1-2 1-3 --after 2-1 2-2 2-3
    done
done
