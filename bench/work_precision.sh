#!/bin/sh
# What accuracy costs with every method (work_precision.mac): error reached, CPU seconds of the whole call, evaluations.
# MAXIMA chooses: MAXIMA="maxima -l sbcl" bench/work_precision.sh
set -eu
cd "$(dirname "$0")/.."
TIMEOUT=900 rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ batchload(\"$PWD/bench/work_precision.mac\")\$" |
  grep '^work:'
