#!/bin/sh
# One run and verified motions beside heyoka, which does not verify: CPU milliseconds at the same true error, 1e-9 and
# 1e-12; see equal_error.mac and equal_error.py.  MAXIMA chooses: MAXIMA="maxima -l sbcl" bench/equal_error.sh
set -eu
cd "$(dirname "$0")/.."
. bench/peers.sh
"$python" -c 'import heyoka' 2> /dev/null || "$python" -m pip install -q heyoka ||
  { echo "equal error: heyoka is not there: $python -m pip install heyoka"; exit; }
TIMEOUT=1200 rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ batchload(\"$PWD/bench/equal_error.mac\")\$" |
  "$python" -B bench/equal_error.py
