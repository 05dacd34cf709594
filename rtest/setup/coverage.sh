#!/bin/sh
# coverage.sh [NAME ...]: runs the tests (all, or those named) and prints the functions that none of them calls, file by
# file.  On SBCL, which is fetched at the first run.
set -u
here=$(cd "$(dirname "$0")" && pwd)
COVERAGE=$(mktemp -d) || exit 1
trap 'rm -rf "$COVERAGE"' EXIT
MAXIMA="'$here/maxima_sbcl.sh'"
export COVERAGE MAXIMA
"$here/run_tests.sh" "$@"
cd "$here/../.." && "$here/run_maxima.sh" --very-quiet --run-string="load(\"rtest/run.lisp\")\$
  load(\"share/anmech/anmech.mac\")\$ load(\"rtest/coverage.lisp\")\$ not_covered(\"$COVERAGE\")\$"
