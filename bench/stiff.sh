#!/bin/sh
# Stiff motions: milliseconds and errors of method = radau; see stiff.mac.
set -eu
cd "$(dirname "$0")/.."
TIMEOUT=300 rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ batchload(\"$PWD/bench/stiff.mac\")\$" | grep '^stiff: \|rror'
