#!/bin/sh
# The energy of Kepler's motion over 100 000 periods, or as many as PERIODS says; see kepler_long.mac.  The picture goes to out/.
set -eu
cd "$(dirname "$0")/.."
mkdir -p out
TIMEOUT=3000 rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ target : \"$PWD/out\"\$ periods : ${PERIODS:-100000}\$ batchload(\"$PWD/bench/kepler_long.mac\")\$" |
  grep '^kepler_long: \|rror'
