#!/bin/sh
# compile_kernel.sh: compiles what is not compiled yet of this tree's kernel, lest every Maxima that begins does so.
# Variables: as for run_maxima.sh.
set -u
here=$(cd "$(dirname "$0")" && pwd)
"$here/run_maxima.sh" --very-quiet \
  --run-string="load(\"$here/../../share/anmech/anmech.mac\")\$ anmech_compile_kernel()\$" > /dev/null 2>&1
