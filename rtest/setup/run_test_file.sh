#!/bin/sh
# run_test_file.sh FILE DIRECTORY: runs one file of tests in a Maxima of its own, prints what came of it, and leaves
# the numbers of problems passed, failed and skipped in DIRECTORY/counts, and the seconds that it took in
# DIRECTORY/seconds.  A file that does not reach its end, or holds no test, counts as one failure more.  Variables: as
# for run_maxima.sh, and TALLY: what failed is told once more in the file TALLY.failures.
set -u
here=$(cd "$(dirname "$0")" && pwd)
file=$1
work=$2/$(basename "$file" .mac)
mkdir "$work" || exit 1

start=$(date +%s)
: > "$work/log"
touch "$work/report.txt"
if [ -r "$file" ]; then
  DIRECTORY=$work "$here/run_maxima.sh" --very-quiet \
    --run-string="load(\"$here/../run.lisp\")\$ run_tests(\"$file\", \"$work/report\")\$" > "$work/log" 2>&1
  status=$?
  [ -e "$work/report" ] && mv "$work/report" "$work/report.txt"
else
  status=missing
fi

# Status 1 without an end: run.lisp itself has said what happened.
awk -v name="$(basename "$file" .mac)" -v status="$status" -v limit="${TIMEOUT:-600}" -v log_file="$work/log" \
    -v counts="$2/counts" -v times="$2/seconds" -v seconds="$(($(date +%s) - start))" '
  /^@problem / { problem = "problem " $2 ($3 == "-" ? "" : " (line " $3 ")"); running = 1
                 input = $0; sub(/^@problem [^ ]+ [^ ]+ /, "", input); next }
  /^@passed/   { passed++; running = 0; next }
  /^@failed/   { failed++; running = 0; next }
  /^@skipped/  { skipped++; running = 0; why = $0; sub(/^@skipped */, "", why); next }
  /^@end /     { seconds = $2; ended = 1; next }
               { text[++lines] = $0 }
  END {
    if (!ended || passed + failed + skipped == 0) failed++
    printf "%-30s %4d passed %4d failed %8.1f s%s\n", name, passed, failed, seconds,
           (skipped ? "   (" skipped " skipped: " why ")" : "")
    for (i = 1; i <= lines; i++) print text[i]
    if (status == "missing") print "  there is no such file"
    else if (!ended) {
      print "  stopped " (status == 124 ? "by the time limit of " limit " s" : "half-way, with exit status " status) \
            (problem == "" ? ", before the first problem" : (running ? ", in " : ", after ") problem)
      if (running) print "    input     " input
      if (status != 1) while ((getline line < log_file) > 0) tail[++n] = line
      for (i = (n > 15 ? n - 14 : 1); i <= n; i++) print "    | " tail[i]
    }
    else if (passed + failed == 1 && problem == "") print "  there is no test in it"
    print passed + 0, failed + 0, skipped + 0 >> counts
    if (status != "missing") print name, seconds >> times
  }' "$work/report.txt" > "$work/summary"
cat "$work/summary"
[ -z "${TALLY:-}" ] || head -n 1 "$work/summary" | grep -q ' 0 failed' || cat "$work/summary" >> "$TALLY.failures"
