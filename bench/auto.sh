#!/bin/sh
# What taylor and dop853 cost, and which of them method = auto takes; see auto.mac.  MAXIMA chooses.
set -eu
cd "$(dirname "$0")/.."
TIMEOUT=600 rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ batchload(\"$PWD/bench/auto.mac\")\$" | grep '^auto:'
