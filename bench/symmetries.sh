#!/bin/sh
# Point symmetries: what anmech, delierium and SymPy find, and how long it takes; see symmetries.mac and symmetries.py.
# LIMIT: seconds for a task of delierium (60).
set -eu
cd "$(dirname "$0")/.."
. bench/peers.sh
need_delierium
found=$(mktemp)
trap 'rm -f "$found"' EXIT
TIMEOUT=900 rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ batchload(\"$PWD/bench/symmetries.mac\")\$" > "$found"
"$delierium" bench/symmetries.py "$found"
