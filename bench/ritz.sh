#!/bin/sh
# How accurate Ritz's method is with how many coefficients in what time (ritz.mac), and the same two problems between
# fixed ends by SciPy's collocation, solve_bvp (ritz.py).
set -eu
cd "$(dirname "$0")/.."
. bench/peers.sh
TIMEOUT=900 rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ batchload(\"$PWD/bench/ritz.mac\")\$" |
  grep 'coefficients: \|rror'
"$python" bench/ritz.py
