#!/bin/sh
# The solved form of long equations of motion, and what does without it; see solved.mac.
set -eu
cd "$(dirname "$0")/.."
rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ batchload(\"$PWD/bench/solved.mac\")\$" | grep '^solved'
