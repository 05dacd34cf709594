#!/bin/sh
# Right-hand sides in generated code: calls per second in Lisp and of the same code in C (gcc -O2), in one run.
# Target: at least half the calls of C on GCL and SBCL.  MAXIMA chooses: MAXIMA="maxima -l sbcl" bench/rhs_c.sh
set -eu
cd "$(dirname "$0")/.."
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
names="front : \"$PWD/share/anmech/anmech.mac\"\$ target : \"$scratch/generated.c\"\$"
rtest/setup/run_maxima.sh --very-quiet "--batch-string=$names batchload(\"$PWD/bench/rhs_c.mac\")\$" |
  grep '^rhs' > "$scratch/lisp"
gcc -O2 -I "$scratch" -o "$scratch/measure" bench/rhs_c.c -lm
"$scratch/measure" > "$scratch/c"
awk 'NR == FNR { c[$2] = $3; next }
     { printf "rhs: %-20s %3d operations  %6.1f ns in Lisp  %6.1f ns in C  %3.0f %% of the calls of C\n",
              $2, $4, $3, c[$2], 100 * c[$2] / $3 }' "$scratch/c" "$scratch/lisp"
