#!/bin/sh
# Motions, verified, beside SciPy's DOP853 and heyoka, which do not verify: CPU milliseconds in one run; see motion.mac
# and motion.py.  MAXIMA chooses: MAXIMA="maxima -l sbcl" bench/motion.sh
set -eu
cd "$(dirname "$0")/.."
. bench/peers.sh
"$python" -c 'import heyoka' 2> /dev/null || "$python" -m pip install -q heyoka || true
TIMEOUT=${TIMEOUT:-3600} rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ batchload(\"$PWD/bench/motion.mac\")\$" | grep '^motion:'
"$python" bench/motion.py
