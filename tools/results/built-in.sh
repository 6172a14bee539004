#!/usr/bin/env bash
# docs/explanation/results.md: The built-in network is the most accurate of three on most of our test sets. Writes into the current folder.
set -euo pipefail
srflow render --preset wild --scenes 16 --frames 3 --size 550x802 --seed 9001 --splits 0,0,1 --regions --out built-in
srflow eval --dataset srflow:built-in --split test --regions --small-motion 0.5 --method srflow tvl1 farneback
