#!/usr/bin/env bash
# docs/explanation/avatars.md: An avatar from a video. Needs MediaPipe's networks (SRFLOW_FACE_MODELS), and for the row of LAM the folder of
# an avatar as argument. Writes into the current folder, one JSON a row.
set -euo pipefail
# NAME HEAD MODEL CAMERAS
row() {
  local name=$1 head=$2 model=$3 cameras=$4 tables=()
  srflow avatar capture --head "$head" --seed 1 --cameras "$cameras" --timesteps 60 --size 640x360 --noise 1 \
    --background '#707880' --out "$name/capture"
  for picture in "$name"/capture/images/00000_*.png; do
    camera=$(basename "$picture" .png)
    camera=${camera#*_}
    srflow face "$name"/capture/images/*_"$camera".png -o "$name/$camera.csv"
    tables+=(--landmarks-of "$((10#$camera))=$name/$camera.csv")
  done
  srflow avatar fit "$name/capture" --model "$model" --photometric "${tables[@]}" --out "$name/fit"
  srflow avatar train "$name/fit" --config video --set apply_masks=true --iterations 2000 --out "$name/avatar"
  srflow avatar eval "$name/avatar" "$name/fit" --flow --truth "$name/capture" --json > "$name.json"
}
for cameras in 1 4; do
  row "builtin-$cameras" builtin builtin-average "$cameras"
done
if [ $# -gt 0 ]; then
  row lam-1 "lam:$1" "lam:$1" 1
fi
