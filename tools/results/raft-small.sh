#!/usr/bin/env bash
# docs/explanation/results.md: An hour on two cores trains a network that beats the classical methods. Writes into the current folder.
set -euo pipefail
srflow render --look 1 --out small --scenes 24 --frames 16 --size 550x802
srflow train --config cpu-small --data srflow:small --out runs/cpu-small
srflow eval --dataset srflow:small --split test --method farneback tvl1 raft-small=runs/cpu-small/best.safetensors
