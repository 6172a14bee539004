#!/usr/bin/env bash
# docs/explanation/avatars.md: An avatar from a video. Needs MediaPipe's networks (SRFLOW_FACE_MODELS). Writes into the current folder, one
# JSON for each number of cameras, with and without opaque_mesh.
set -euo pipefail
for cameras in 1 4; do
  name=builtin-$cameras
  srflow avatar capture --head builtin --seed 1 --cameras "$cameras" --timesteps 60 --size 640x360 --noise 1 \
    --background '#707880' --out "$name/capture"
  tables=()
  for picture in "$name"/capture/images/00000_*.png; do
    camera=$(basename "$picture" .png)
    camera=${camera#*_}
    srflow face "$name"/capture/images/*_"$camera".png -o "$name/$camera.csv"
    tables+=(--landmarks-of "$((10#$camera))=$name/$camera.csv")
  done
  srflow avatar fit "$name/capture" --model builtin-average --photometric "${tables[@]}" --out "$name/fit"
  for opaque in true false; do
    srflow avatar train "$name/fit" --config video --set apply_masks=true --set opaque_mesh=$opaque --iterations 2000 \
      --out "$name/avatar-$opaque"
    srflow avatar eval "$name/avatar-$opaque" "$name/fit" --flow --truth "$name/capture" --json > "$name-$opaque.json"
  done
done
