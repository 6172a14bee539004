#!/usr/bin/env bash
# docs/explanation/micro-expression-protocol.md: Apex. Writes into the current folder.
set -euo pipefail
srflow mer synth --look 1 --out set --subjects 8 --clips 6 --side 192 --seed 5                      # strength 1
srflow mer synth --look 1 --out weak --subjects 8 --clips 6 --side 192 --seed 6 --intensity 0.25    # strength 0.25
srflow mer apex clips:set clips:weak --method farneback
srflow mer apex clips:set clips:weak --method farneback --rule strain
srflow mer apex clips:set clips:weak --rule ratio
