#!/usr/bin/env bash
# docs/guides/spotting.md: How accurate it is. Writes into the current folder.
set -euo pipefail
srflow mer synth-long --look 1 --out test --subjects 6 --minutes 1.5 --intensity 0.5 --seed 41
srflow mer spot test/s0* --fps 30 --landmarks test/landmarks.csv --out spotted
srflow mer spot-score spotted/events.csv --truth test/events.csv
