#!/bin/sh
# run_tests.sh [NAME ...]: runs files of tests, every one in a Maxima of its own, as many at a time as there are
# processors, and prints as its last line "N passed, N failed".  Without names, all rtest/rtest_*.mac, those first that
# took longest when they were last run on this Maxima; a name may be rtest_x, x or a path.  Status 0 if there was no
# failure, 2 if this Maxima does not run (one failure).  Variables:
#   MAXIMA      the command, perhaps with options                             (maxima)
#   JOBS        files to run at a time                                        (the number of processors)
#   TIMEOUT     seconds that a file may take                                  (600)
#   TALLY       a file: the two numbers are added to it, not printed          (none)
set -u
here=$(cd "$(dirname "$0")" && pwd)
tests=$(dirname "$here")
TIMEOUT=${TIMEOUT:-600}
export TIMEOUT
processors=$(nproc 2> /dev/null || getconf _NPROCESSORS_ONLN 2> /dev/null || echo 1)

work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM

path_of() {
  for path in "$1" "$tests/$1" "$tests/$1.mac" "$tests/rtest_$1.mac"; do
    [ -f "$path" ] && { echo "$(cd "$(dirname "$path")" && pwd)/$(basename "$path")"; return; }
  done
  echo "$1"
}

# The longest first, lest a processor wait for one in the end.  $1 has lines "name seconds"; a file that is not among
# them comes before all others: one that loads another file, and so is longer than it looks, then the larger one, a
# long problem being worth a hundred lines.
longest_first() {
  for path in "$tests"/rtest_*.mac; do
    echo "$(wc -c < "$path") $(grep -c 'load(' "$path") $(grep -c '^long_problem(' "$path") $path"
  done | awk -v known="$1" '
    BEGIN { while ((getline line < known) > 0) { split(line, part, " "); seconds[part[1]] = part[2] } }
    { path = $0; sub(/^ *[0-9]+ +[0-9]+ +[0-9]+ /, "", path)
      name = path; sub(/.*\//, "", name); sub(/\.mac$/, "", name)
      print (name in seconds ? seconds[name] : ($2 > 0 ? 2e6 : 1e6) + $1 + 5e3*$3) " " path }' |
    sort -rn | sed 's/^[^ ]* //'
}

"$here/run_maxima.sh" --very-quiet --run-string='block([b : build_info()],
  print("Maxima", b@version, "on", b@lisp_name, b@lisp_version))$' > "$work/version" 2>&1
runs=1
if grep '^Maxima [0-9]' "$work/version"; then
  known=${XDG_CACHE_HOME:-$HOME/.cache}/anmech/seconds/$(grep '^Maxima [0-9]' "$work/version" | tr -cs 'A-Za-z0-9.' _)
  mkdir -p "$(dirname "$known")"
  touch "$known"
  : > "$work/counts"
  : > "$work/seconds"
  [ $# != 0 ] || "$here/compile_kernel.sh"
  if [ $# = 0 ]; then longest_first "$known"; else for name; do path_of "$name"; done; fi | tr '\n' '\0' |
    xargs -0 -n 1 -P "${JOBS:-$processors}" sh -c '"$0/run_test_file.sh" "$2" "$1"' "$here" "$work"
  awk '{ seconds[$1] = $2 } END { for (name in seconds) print name, seconds[name] }' "$known" "$work/seconds" \
    > "$known.$$" && mv "$known.$$" "$known"
else
  runs=0
  echo "This Maxima does not run: ${MAXIMA:-maxima}"
  cat "$work/version"
  echo 0 1 > "$work/counts"
fi

if [ -n "${TALLY:-}" ]; then
  cat "$work/counts" >> "$TALLY"
  "$here/total.sh" "$work/counts" > /dev/null
else
  "$here/total.sh" "$work/counts"
fi
status=$?
exit $((runs ? status : 2))
