#!/bin/sh
# What the structure of a mass matrix saves: chains of masses by Lagrange and by Hamilton, in the same run, and matrices
# that are banded and full; see chain.mac.  The goal: at most 1.5 times Hamilton's form.
set -eu
cd "$(dirname "$0")/.."
TIMEOUT=900 rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ batchload(\"$PWD/bench/chain.mac\")\$" |
  grep 'evaluation\|rror'
