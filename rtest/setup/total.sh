#!/bin/sh
# total.sh FILE: adds up the lines "PASSED FAILED" of the file, and prints the line by which a run of tests is judged.
awk '{ passed += $1; failed += $2 }
     END { printf "%d passed, %d failed\n", passed, failed; exit failed > 0 || passed == 0 }' "$1"
