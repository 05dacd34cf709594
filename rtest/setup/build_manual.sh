#!/bin/sh
# build_manual.sh: computes the examples of the manual and of README.md anew, lists the book's sections in both, and
# makes the manual as Maxima reads it and its index.  Status 0 only if every step came to its end, which Maxima's own
# exit status does not tell.
set -u
here=$(cd "$(dirname "$0")" && pwd)
cd "$here/../.." || exit 1
command -v makeinfo > /dev/null || "$here/install_packages.sh" texinfo || exit 1

build() {                                      # build STEP
  "$here/run_maxima.sh" --very-quiet \
    --run-string='load("share/anmech/anmech.mac")$ anmech_need("session/manual.lisp")$
                  anmech_build_manual("'"$1"'")$' > "$log" 2>&1
  grep -q "^The manual's $1: done" "$log" || { cat "$log" >&2; exit 1; }
}

log=$(mktemp) || exit 1
trap 'rm -f "$log"' EXIT
build outputs
"$here/run_maxima.sh" --very-quiet --run-string='load("rtest/run.lisp")$ load("share/anmech/anmech.mac")$
  load("rtest/sections.lisp")$ list_sections();' > "$log" 2>&1
grep -q done "$log" || { cat "$log" >&2; exit 1; }
makeinfo --no-split -o share/anmech/anmech.info share/anmech/anmech.texi || exit 1
build index
