#!/bin/sh
# run_examples.sh [FILE ...]: runs examples (.mac or .wxm), by default all of examples/, as a user runs them with --batch.
# An example says by its last line, "ok", that it came to its end.  Pictures go to out/.  Status 0 if all were ok.
# Variables: MAXIMA and TIMEOUT, as for run_maxima.sh; and TALLY, a file to which the numbers of those that passed and
# failed are added: then an example prints one line if it is ok.
set -u
here=$(cd "$(dirname "$0")" && pwd)
cd "$here/../.." || exit 1
mkdir -p out
log=$(mktemp) || exit 1
trap 'rm -f "$log"' EXIT

# Maxima prints the name of the file after its last line.
run() {
  "$here/run_maxima.sh" --very-quiet --batch="$PWD/$1" 2>&1 | if [ -n "${TALLY:-}" ]; then cat > "$log"; else tee "$log"; fi
  tail -n 3 "$log" | grep -q '^ok *$'
}

passed=0 failed=0
[ $# -gt 0 ] || set -- examples/*.mac examples/*.wxm
for example; do
  [ -e "$example" ] || continue
  start=$(date +%s)
  if run "$example"; then
    passed=$((passed + 1))
    word=ok
  else
    failed=$((failed + 1))
    word=failed
    [ -z "${TALLY:-}" ] || tail -n 30 "$log"
  fi
  [ -z "${TALLY:-}" ] || printf '%-44s %13s %8.1f s\n' "$example" $word $(($(date +%s) - start))
  [ $word = ok ] || [ -n "${TALLY:-}" ] || echo "$example stopped before its end." >&2
done
[ -z "${TALLY:-}" ] || echo $passed $failed >> "$TALLY"
[ $failed = 0 ]
