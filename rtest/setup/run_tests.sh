#!/bin/sh
# run_tests.sh [NAME ...]: runs files of tests, every one in a Maxima of its own, as many at a time as there are processors,
# and prints as its last line "N passed, N failed".  Without names, all rtest/rtest_*.mac; a name may be rtest_x, x or a
# path.  Status 0 if there was no failure.  Variables:
#   JOBS                        files to run at a time                     (the number of processors)
#   TIMEOUT                     seconds that a file may take               (300)
#   MAXIMA                      the command, perhaps with options          (maxima)
#   TALLY                       a file to which the two numbers are added  (none)
set -u
here=$(cd "$(dirname "$0")" && pwd)
tests=$(dirname "$here")
TIMEOUT=${TIMEOUT:-300}
export TIMEOUT
processors=$(nproc 2> /dev/null || getconf _NPROCESSORS_ONLN 2> /dev/null || echo 1)
# The tests run elsewhere, so a command named by a relative path must be made absolute.
MAXIMA=${MAXIMA:-maxima}
case $MAXIMA in
  ./* | ../*) MAXIMA="'$PWD'/$MAXIMA" ;;
esac
export MAXIMA

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

[ $# -gt 0 ] || set -- "$tests"/rtest_*.mac
: > "$work/counts"
for name; do path_of "$name"; done | tr '\n' '\0' |
  xargs -0 -n 1 -P "${JOBS:-$processors}" sh -c '"$0/run_test_file.sh" "$2" "$1"' "$here" "$work"

[ -n "${TALLY:-}" ] && cat "$work/counts" >> "$TALLY"
awk '{ passed += $1; failed += $2 }
     END { printf "%d passed, %d failed\n", passed, failed; exit failed > 0 || passed == 0 }' "$work/counts"
