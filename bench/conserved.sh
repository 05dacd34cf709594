#!/bin/sh
# Conserved quantities: how many of those known are found, and how long each method takes; see conserved.mac.
set -eu
cd "$(dirname "$0")/.."
TIMEOUT=1800 rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ batchload(\"$PWD/bench/conserved.mac\")\$" |
  grep '^conserved\|rror'
