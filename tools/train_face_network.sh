#!/usr/bin/env bash
# Trains the weights in crates/nets/weights from those of srflow 0.1.0. Writes into the current folder: the last line's file.
#
#   tools/train_face_network.sh FACEXMODEL     # the folder of ICT-FaceKit; identities 80 to 99 are left out, for tests
#
# Two cores take about two and a half hours.
set -euo pipefail
tools=$(cd "$(dirname "$0")" && pwd)
mkdir -p ict
cp -n "$1"/* ict
rm -f ict/identity08?.obj ict/identity09?.obj

render="srflow render --look 1 --size 440x640 --splits 1,0,0"
$render --background white --scenes 16 --frames 12 --seed 516 --out clean-white
$render --scenes 32 --frames 12 --seed 532 --out clean-procedural
$render --preset wild --scenes 40 --frames 5 --seed 621 --out fast-wild
$render --background white --scenes 12 --frames 5 --seed 622 --out fast-plain
synth="srflow mer synth --look 1 --only-key-frames --side 256 --subjects 16 --clips 6"
$synth --intensity 0.15 --seed 611 --out weak-0.15
$synth --intensity 0.3 --seed 612 --out weak-0.3
$synth --intensity 0.6 --noise 1.5 --drift 3 --seed 613 --out weak-0.6
$synth --intensity 1.2 --drift 2 --seed 614 --out weak-1.2

git -C "$tools" show d08addb2:crates/nets/weights/srflow.safetensors > older.safetensors
python "$tools/older_srflow_weights.py" older.safetensors start.safetensors
common="--config srflow --set training.rising=0.03 --set training.extra_steps=20"
still="--data rendered:*12 --data rendered:ict:ict*8 --data shapes:*2 --data srflow:clean-white*20 --data srflow:clean-procedural*20
    --set augmentation.log2_scale=[-0.6,1.0] --set augmentation.max_shift=12"
srflow train $common $still --weights start.safetensors --steps 6000 --stop-after-step 1250 --learning-rate 5e-4 \
    --set data.rendered.seed=4000 --set data.shapes.seed=4000 --set augmentation.still_probability=0.06 \
    --set augmentation.shift_probability=0.25 --set loss.strain=0.5 --out run-1 || [ $? -eq 75 ]
srflow train $common $still --weights run-1/last.safetensors --steps 2700 --learning-rate 4.5e-4 \
    --set data.rendered.seed=5000 --set data.shapes.seed=5000 --set augmentation.still_probability=0.08 \
    --set augmentation.shift_probability=0.4 --set loss.strain=0.25 --out run-2
srflow train $common --data 'rendered:*7' --data 'rendered:ict:ict*5' --data 'shapes:*1' \
    --data 'srflow:clean-white*15' --data 'srflow:clean-procedural*15' --data 'srflow:fast-wild*24' --data 'srflow:fast-plain*30' \
    --data 'clips:weak-0.15@all*24' --data 'clips:weak-0.3@all*36' --data 'clips:weak-0.6@all*30' --data 'clips:weak-1.2@all*16' \
    --weights run-2/best.safetensors --steps 4000 --learning-rate 5e-4 \
    --set data.rendered.seed=6000 --set data.shapes.seed=6000 --out run-3
srflow models export run-3/best.safetensors --half -o srflow.safetensors
