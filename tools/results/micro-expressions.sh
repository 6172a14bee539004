#!/usr/bin/env bash
# docs/explanation/results.md: Micro-expressions: the pipeline works; better flow is not yet better recognition. Writes into the current folder.
set -euo pipefail
srflow mer synth --out mer-set --subjects 8 --clips 12 --side 192 --fps 60 --intensity 0.25 --noise 2 --drift 2 --lighting 2 --seed 7
srflow mer run --data clips:mer-set --seed 1 --iters 4 --method farneback srflow tvl1 --out mer-results
