#!/bin/sh
# Only what the scene requires: what a coarser question costs beside a finer one; see scene.mac.
# MAXIMA chooses: MAXIMA="maxima -l sbcl" bench/scene.sh
set -eu
cd "$(dirname "$0")/.."
rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ batchload(\"$PWD/bench/scene.mac\")\$" | grep '^scene:'
