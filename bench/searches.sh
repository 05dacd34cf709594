#!/bin/sh
# Searches for Mei symmetries and equivalent Lagrangians; see searches.mac.
set -eu
cd "$(dirname "$0")/.."
rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ batchload(\"$PWD/bench/searches.mac\")\$" | grep '^searches'
