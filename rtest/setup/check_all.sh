#!/bin/sh
# check_all.sh [NAME ...]: runs the tests, the examples and the installation on three Maximas: the one at hand (or
# MAXIMA), the distribution's version on SBCL, and 5.50 on ECL; the two latter are fetched at the first run.  What
# failed is told once more at the end; the last line is the total over all, "N passed, N failed".  Names and variables:
# as for run_tests.sh; with names, only those tests are run.
set -u
here=$(cd "$(dirname "$0")" && pwd)
directory=$(mktemp -d) || exit 1
trap 'rm -rf "$directory"' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM
TALLY=$directory/tally
export TALLY
: > "$TALLY"
: > "$TALLY.failures"

# On ECL, whose kernel is interpreted, the other examples take minutes each; they show what is the same everywhere.
quick="demo.mac ch16_field_method.wxm ch17_potential_method.wxm ch18_last_multiplier.wxm ch21_form_invariance.wxm
  ch24_inverse.wxm ch25_principles.wxm tour.wxm"

# The two others are made while the first is tested; what goes wrong is told when they are needed.
for name in sbcl ecl; do "$here/maxima_$name.sh" --version; done > "$directory/made" 2>&1 < /dev/null &

for MAXIMA in "${MAXIMA:-maxima}" "'$here/maxima_sbcl.sh'" "'$here/maxima_ecl.sh'"; do
  export MAXIMA
  echo
  examples=
  # The long problems of a file are run on one of the two whose kernel is compiled (rtest/run.lisp).
  export PART=0
  case $MAXIMA in
    *maxima_sbcl*) PART=1 ;;
    *maxima_ecl*)
      unset PART
      TIMEOUT=${TIMEOUT:-1500}                                     # searches take it five to ten times as long
      export TIMEOUT
      for example in $quick; do examples="$examples examples/$example"; done ;;
  esac
  # The installation, one process that mostly compiles, beside the tests.
  : > "$directory/installation.tally"
  if [ $# = 0 ]; then
    TALLY=$directory/installation.tally "$here/check_install.sh" > "$directory/installation" 2>&1 &
  fi
  "$here/run_tests.sh" "$@"
  runs=$?
  [ $runs = 2 ] || [ $# != 0 ] || "$here/run_examples.sh" $examples       # all, if none is named
  wait
  if [ $runs != 2 ] && [ $# = 0 ]; then
    cat "$directory/installation"
    cat "$directory/installation.tally" >> "$TALLY"
    grep -q ' 0 failed' "$directory/installation" || cat "$directory/installation" >> "$TALLY.failures"
  fi
done
if [ -s "$TALLY.failures" ]; then
  echo
  echo "What failed:"
  cat "$TALLY.failures"
fi
echo
"$here/total.sh" "$TALLY"
