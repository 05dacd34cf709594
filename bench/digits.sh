#!/bin/sh
# Motions of 30 and of 100 digits, verified: see digits.mac.  MAXIMA chooses: MAXIMA="maxima -l sbcl" bench/digits.sh
set -eu
cd "$(dirname "$0")/.."
rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ batchload(\"$PWD/bench/digits.mac\")\$" | grep '^digits:'
