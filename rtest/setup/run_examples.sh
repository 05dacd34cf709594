#!/bin/sh
# run_examples.sh [FILE ...]: runs examples (.mac or .wxm), as a user runs them with --batch; by default all of
# examples/.  An example says by its last line, "ok", that it came to its end.  The package is that of this tree.
# Pictures go to out/, in a folder for each example.  Status 0 if all were ok.
# Variables: MAXIMA and TIMEOUT, as for run_maxima.sh; and TALLY, a file to which the numbers of those that
# passed and failed are added: then one line tells of each example, instead of all that it prints, and as many run at
# a time as there are processors (JOBS).
set -u
here=$(cd "$(dirname "$0")" && pwd)
cd "$here/../.." || exit 1
mkdir -p out
directory=$(mktemp -d) || exit 1
trap 'rm -rf "$directory"' EXIT
log=$directory/log
init=$directory/init.mac                        # by its ending Maxima 5.50 knows what it is
export TALLY=${TALLY:-}

run() {
  if [ -e "$1" ]; then
    name=$(basename "$1")
    printf '%s\n' "file_search_maxima : cons(\"$PWD/share/anmech/\$\$\$.mac\", file_search_maxima)\$" \
      'load("anmech")$' "picture_folder(\"$PWD/out/${name%.*}\")\$" > "$init"
    "$here/run_maxima.sh" --very-quiet --init-mac="$init" --batch="$PWD/$1" 2>&1
  else
    echo "There is no file $1."
  fi | if [ -n "$TALLY" ]; then cat > "$log"; else tee "$log"; fi
  tail -n 3 "$log" | grep -q '^ok *$'          # after its last line, Maxima prints the name of the file
}

passed=0 failed=0
[ $# -gt 0 ] || set -- examples/*.mac examples/*.wxm
if [ -n "$TALLY" ] && [ $# -gt 1 ]; then
  processors=$(nproc 2> /dev/null || getconf _NPROCESSORS_ONLN 2> /dev/null || echo 1)
  printf '%s\0' "$@" | xargs -0 -n 1 -P "${JOBS:-$processors}" "$here/run_examples.sh"
  exit
fi
for example; do
  case $example in *'*'*) continue ;; esac     # no examples of this kind
  start=$(date +%s)
  if run "$example"; then
    passed=$((passed + 1)) verdict=ok
  else
    failed=$((failed + 1)) verdict=failed
  fi
  if [ -n "$TALLY" ]; then
    {
      printf '%-44s %13s %8.1f s\n' "$example" $verdict $(($(date +%s) - start))
      [ $verdict = ok ] || tail -n 30 "$log" | sed 's/^/    | /'
    } > "$directory/told"
    cat "$directory/told"
    [ $verdict = ok ] || cat "$directory/told" >> "$TALLY.failures"
  elif [ $verdict = failed ]; then
    echo "$example stopped before its end." >&2
  fi
done
[ -z "$TALLY" ] || echo $passed $failed >> "$TALLY"
[ $failed = 0 ]
