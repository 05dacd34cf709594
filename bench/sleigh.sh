#!/bin/sh
# The demonstration's motion to an error of 1e-9, beside SciPy's DOP853; see sleigh.mac and sleigh.py.
set -eu
cd "$(dirname "$0")/.."
. bench/peers.sh
rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ batchload(\"$PWD/bench/sleigh.mac\")\$" | grep '^sleigh'
"$python" bench/sleigh.py
