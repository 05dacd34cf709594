#!/bin/sh
# total.sh FILE: adds up the lines "PASSED FAILED [SKIPPED]" of the file, and prints the line by which a run of tests is
# judged.
awk '{ passed += $1; failed += $2; skipped += $3 }
     END { printf "%d passed, %d failed", passed, failed
           printf (skipped ? ", %d skipped\n" : "\n"), skipped
           exit failed > 0 || passed == 0 }' "$1"
