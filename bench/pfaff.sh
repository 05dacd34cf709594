#!/bin/sh
# What the discrete Pfaff-Birkhoff principle conserves over a million steps, beside DOP853 at equal cost; see pfaff.mac.
# Pictures go to out/.
set -eu
cd "$(dirname "$0")/.."
mkdir -p out
TIMEOUT=900 rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ target : \"$PWD/out\"\$ batchload(\"$PWD/bench/pfaff.mac\")\$" |
  grep ' pfaff of \| dop853, \|rror'
