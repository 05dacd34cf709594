#!/bin/sh
# Derivation of the n-link pendulum against SymPy, side by side; see pendulum.mac and pendulum.py.
set -eu
cd "$(dirname "$0")/.."
. bench/peers.sh
rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ batchload(\"$PWD/bench/pendulum.mac\")\$" | grep '^pendulum'
"$python" bench/pendulum.py
