#!/bin/sh
# Proved bounds of motions beside the estimates of their errors: see rigorous.mac.  About two minutes on SBCL:
# MAXIMA="maxima -l sbcl" bench/rigorous.sh
set -eu
cd "$(dirname "$0")/.."
TIMEOUT=900 rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ batchload(\"$PWD/bench/rigorous.mac\")\$" |
  grep '^rigorous: \|rror'
