#!/bin/sh
# Explicit symplectic steps: milliseconds and energy of method = composition; see composition.mac.
set -eu
cd "$(dirname "$0")/.."
TIMEOUT=300 rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ batchload(\"$PWD/bench/composition.mac\")\$" |
  grep '^composition: \|rror'
