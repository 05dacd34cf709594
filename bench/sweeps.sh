#!/bin/sh
# Sweeps: microseconds of CPU for a short motion of a double pendulum beside the same method in C and heyoka's batches;
# what a chunk costs beside its motions; two workers; and the flip map, 300 x 300 motions, into
# examples/pictures/flip_map.png.
# MAXIMA chooses: MAXIMA="maxima -l sbcl" bench/sweeps.sh; MOTIONS=300 has 90 000 motions everywhere (100); PICTURE=no
# leaves out the map.
set -eu
cd "$(dirname "$0")/.."
. bench/peers.sh
"$python" -c 'import heyoka' 2> /dev/null || "$python" -m pip install -q heyoka || true
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
n=${MOTIONS:-100}
rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ motions : $n\$ batchload(\"$PWD/bench/sweeps.mac\")\$" |
  grep '^sweep:'
gcc -O2 -o "$work/sweeps" bench/sweeps.c -lm
"$work/sweeps" 21 3 1e-13 table > "$work/exact"
for tolerance in 1e-7 1e-10; do
  "$work/sweeps" "$n" 3 $tolerance > "$work/time"
  "$work/sweeps" 21 3 $tolerance table | paste -d, - "$work/exact" | awk -F, -v time="$(cat "$work/time")" -v n="$n" \
    -v tolerance=$tolerance '
    function abs(x) { return x < 0 ? -x : x }
    { worst = 0; for (k = 1; k <= 4; k++) if (abs($k - $(k + 4)) > worst) worst = abs($k - $(k + 4)); print worst }' |
    sort -g | awk -v time="$(cat "$work/time")" -v n="$n" -v tolerance=$tolerance '
    { error[NR] = $1 } END { split(time, part, " ")
      printf "C: tolerance %s: %.1f us a motion, median error %.2g\n", tolerance, 1e6 * part[1] / n / n, error[221] }'
done
"$python" bench/sweeps.py "$n"

# A chunk of no more than one motion shows what a worker costs; the same chunks by one worker and by two, in seconds of
# the clock: on a machine that does nothing else, their ratio is the efficiency.
cat > "$work/problem.mac" << END
load("$PWD/share/anmech/anmech.mac")\$
s : ode_system([-x], [x])\$
END
for workers in 1 2; do
  start=$(date +%s.%N)
  rtest/setup/run_maxima.sh --very-quiet --batch-string="load(\"$work/problem.mac\")\$
    sweep(s, [], [0, 1], [[x, 1, 2, 8]], workers = $workers, folder = \"$work/w$workers\", chunk = 1)\$" > "$work/log" 2>&1
  echo "$workers $(date +%s.%N) $start"
done | awk '{ seconds[$1] = $2 - $3 } END {
  printf "eight chunks of one motion: %.2f s by one worker, %.2f s by two\n", seconds[1], seconds[2] }'

[ "${PICTURE:-yes}" = yes ] || exit 0
TIMEOUT=7200 rtest/setup/run_maxima.sh --very-quiet --batch-string="front : \"$PWD/share/anmech/anmech.mac\"\$
  count : 300\$ folder : \"$work/flip_map\"\$ picture : \"$PWD/examples/pictures/flip_map.png\"\$
  batchload(\"$PWD/bench/flip_map.mac\")\$"
