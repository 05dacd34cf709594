#!/bin/sh
# Sweeps: microseconds of CPU for a short motion of a double pendulum, one by one and with simd = true, beside the first
# method in C and heyoka's batches; what a chunk costs beside its motions; two workers; and the flip map, 300 x 300
# motions, into examples/pictures/flip_map.png.
# MAXIMA chooses: MAXIMA="maxima -l sbcl" bench/sweeps.sh; MOTIONS=300 has 90 000 motions everywhere (3600, of which each
# time is the least of seven), POINTS so many in each chunk of the comparison of workers (10000); PICTURE=no leaves out
# the map.
set -eu
cd "$(dirname "$0")/.."
. bench/peers.sh
"$python" -c 'import heyoka' 2> /dev/null || "$python" -m pip install -q heyoka || true
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
n=${MOTIONS:-60}
rtest/setup/run_maxima.sh --very-quiet \
  "--batch-string=front : \"$PWD/share/anmech/anmech.mac\"\$ motions : $n\$ batchload(\"$PWD/bench/sweeps.mac\")\$" |
  grep '^sweep:'
gcc -O2 -o "$work/sweeps" bench/sweeps.c -lm
"$work/sweeps" 21 3 1e-13 table > "$work/exact"
for tolerance in 1e-7 1e-10; do
  for run in 1 2 3 4 5 6 7; do "$work/sweeps" "$n" 3 $tolerance; done | sort -g | head -1 > "$work/time"
  "$work/sweeps" 21 3 $tolerance table | paste -d, - "$work/exact" | awk -F, -v time="$(cat "$work/time")" -v n="$n" \
    -v tolerance=$tolerance '
    function abs(x) { return x < 0 ? -x : x }
    { worst = 0; for (k = 1; k <= 4; k++) if (abs($k - $(k + 4)) > worst) worst = abs($k - $(k + 4)); print worst }' |
    sort -g | awk -v time="$(cat "$work/time")" -v n="$n" -v tolerance=$tolerance '
    { error[NR] = $1 } END { split(time, part, " ")
      printf "C: tolerance %s: %.1f us a motion, median error %.2g\n", tolerance, 1e6 * part[1] / n / n, error[221] }'
done
"$python" bench/sweeps.py "$n"

# What one worker and two cost, in seconds of processors: of the session, which begins and ends the sweep, and of all
# workers with GNU parallel.  Chunks of no more than one motion show what a worker costs until it computes.  The
# efficiency of two is what the clock would show on a machine that does nothing else: the session alone, then two at
# work at a time.
engine() { # CHUNKS POINTS WORKERS
  times > "$work/before"
  rtest/setup/run_maxima.sh --very-quiet --batch-string="load(\"$PWD/share/anmech/anmech.mac\")\$
    load(\"$PWD/bench/double_pendulum.mac\")\$
    sweep(pendulum, append(at_rest, [alpha = 1]), [0, 3], [[beta, -3, 3, $1 * $2]], accuracy = 1e-6, verify = false,
      workers = $3, folder = \"$work/engine_$1_$2_$3\", chunk = $2)\$
    printf(true, \"~&session ~,2f~%\", elapsed_run_time())\$" > "$work/log" 2>&1
  times > "$work/after"
  cat "$work/before" "$work/after" | awk -v session="$(sed -n 's/^session //p' "$work/log")" '
    function seconds(text) { split(text, part, "m"); return 60 * part[1] + part[2] }
    NR % 2 == 0 { all[NR] = seconds($1) + seconds($2) }
    END { print session, all[4] - all[2] - session }'
}
echo "$(engine 6 1 1) $(engine 6 1 2)" | awk '{
  printf "engine: chunks of one motion: session %.1f s, a chunk %.2f s by one worker, %.2f s by two\n", $1, $2/6,
    $4/6 }'
points=${POINTS:-10000}
echo "$(engine 6 "$points" 1) $(engine 6 "$points" 2)" | awk -v points="$points" '{
  printf "engine: chunks of %d motions: session %.1f s, a chunk %.2f s by one worker, %.2f s by two; ", points, $1,
    $2/6, $4/6
  printf "efficiency of two: %.2f\n", ($1 + $2) / 2 / ($3 + $4/2) }'

[ "${PICTURE:-yes}" = yes ] || exit 0
TIMEOUT=7200 rtest/setup/run_maxima.sh --very-quiet --batch-string="front : \"$PWD/share/anmech/anmech.mac\"\$
  count : 300\$ folder : \"$work/flip_map\"\$ picture : \"$PWD/examples/pictures/flip_map.png\"\$
  batchload(\"$PWD/bench/flip_map.mac\")\$"
