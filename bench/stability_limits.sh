#!/bin/sh
# The table of the manual that tells what every method does at the extremes (stability_limits.mac): minutes.
# MAXIMA chooses: MAXIMA="maxima -l sbcl" bench/stability_limits.sh
set -eu
cd "$(dirname "$0")/.."
table=$(mktemp)
trap 'rm -f "$table"' EXIT
TIMEOUT=900 rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ table : \"$table\"\$ batchload(\"$PWD/bench/stability_limits.mac\")\$"
grep -q '^@end multitable' "$table" &&                # the states have private names
  sed 's/, which g[0-9]* prevents//; s/diff(g[0-9]*,t)/a velocity/' "$table" > share/anmech/stability_limits.texi
