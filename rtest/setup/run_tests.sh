#!/bin/sh
# run_tests.sh [NAME ...]: runs files of tests, every one in a Maxima of its own, as many at a time as there are
# processors, and prints as its last line "N passed, N failed".  Without names, all rtest/rtest_*.mac; a name may be
# rtest_x, x or a path.  Status 0 if there was no failure, 2 if this Maxima does not run (one failure).  Variables:
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

"$here/run_maxima.sh" --very-quiet --run-string='block([b : build_info()],
  print("Maxima", b@version, "on", b@lisp_name, b@lisp_version))$' > "$work/version" 2>&1
runs=1
if grep '^Maxima [0-9]' "$work/version"; then
  if [ $# = 0 ]; then                          # the longest first, lest a processor wait for it in the end
    set -- "$tests/rtest_verbs.mac"
    for name in "$tests"/rtest_*.mac; do [ "$name" = "$1" ] || set -- "$@" "$name"; done
  fi
  : > "$work/counts"
  for name; do path_of "$name"; done | tr '\n' '\0' |
    xargs -0 -n 1 -P "${JOBS:-$processors}" sh -c '"$0/run_test_file.sh" "$2" "$1"' "$here" "$work"
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
