#!/bin/sh
# draw_house.sh: the plan of the package, read off its files, into CONTRIBUTING.md and as a picture beside it; and here.
# The picture needs Graphviz; without it the old one stays, and the test says that it is old.
set -u
here=$(cd "$(dirname "$0")" && pwd)
cd "$here/../.." || exit 1
"$here/run_maxima.sh" --very-quiet --run-string='load("rtest/run.lisp")$ load("share/anmech/anmech.mac")$
  load("rtest/house.lisp")$ draw_house()$ display2d : false$ printf(true, "~a", house_plan())$' || exit 1
if command -v dot > /dev/null; then
  dot -Tsvg .github/house.dot -o .github/house.svg
else
  echo "no Graphviz here (dot): .github/house.svg is not drawn anew" >&2
fi
