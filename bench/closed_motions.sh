#!/bin/sh
# Motions in closed form.  First last multipliers of the literature: which are found, and whether Lagrangians come of them
# (closed_motions.mac).  Then sixty equations of the second order from Kamke's list: which are solved by anmech, by Maxima's
# ode2 and contrib_ode, and by SymPy, each answer checked by numbers (closed_motions.py).  The equations of both are in
# closed_motions.txt.
# LIMIT: seconds for an equation of Kamke's and a solver (20).
set -eu
cd "$(dirname "$0")/.."
. bench/peers.sh
TIMEOUT=1800 rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ equations : \"$PWD/bench/closed_motions.txt\"\$ only : false\$ batchload(\"$PWD/bench/closed_motions.mac\")\$" |
  grep '^multipliers\|rror'
"$python" bench/closed_motions.py
