#!/bin/sh
# What load("anmech") adds to Maxima's start: medians of 9 pairs of runs, one bare and one with the package, in turn.
# Limit: 0.15 s on GCL and SBCL.  MAXIMA chooses the Maxima.
set -eu
cd "$(dirname "$0")/.."
run() { rtest/setup/run_maxima.sh --very-quiet "--batch-string=$1" > /dev/null; }
now() { date +%s.%N; }
front="load(\"$PWD/share/anmech/anmech.mac\")\$"
run "$front"          # compiles the kernel, once
for turn in 1 2 3 4 5 6 7 8 9; do
  a=$(now); run '1$'; b=$(now); run "$front"; c=$(now)
  echo "$a $b $c"
done | awk '{ bare[NR] = $2 - $1; full[NR] = $3 - $2 }
  function median(x,   i, j, t) {
    for (i = 1; i <= NR; i++) for (j = i + 1; j <= NR; j++) if (x[j] < x[i]) { t = x[i]; x[i] = x[j]; x[j] = t }
    return x[int((NR + 1) / 2)]
  }
  END { b = median(bare); f = median(full)
        printf "load: Maxima alone %.3f s, with anmech %.3f s, added %.3f s (limit 0.15)\n", b, f, f - b }'
