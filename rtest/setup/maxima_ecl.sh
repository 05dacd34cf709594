#!/bin/sh
# maxima_ecl.sh [options of Maxima]: Maxima 5.50.0 on ECL, as the Python package index has it for Linux and macOS.  At
# its first use it is installed into the user's cache.
set -eu
. "$(dirname "$0")/cached_maxima.sh"

make_it() {
  python3 -c 'import ensurepip' || "$(dirname "$0")/install_packages.sh" python3-venv
  rm -rf "$place.new"
  python3 -m venv "$place.new"
  # Not by the script pip, which would hold the name of the directory.
  "$place.new/bin/python3" -m pip install --no-deps --disable-pip-version-check \
    passagemath-maxima==10.8.13 passagemath-ecl==10.8.13
  mv "$place.new" "$place"
}

made_once maxima-ecl "Installing Maxima 5.50 on ECL"
MAXIMA_PREFIX=$(echo "$place"/lib/python3.*/site-packages/sage_wheels)
ECLDIR=$(echo "$MAXIMA_PREFIX"/lib/ecl-*)/           # without the slash at its end ECL does not start
export MAXIMA_PREFIX ECLDIR
exec "$MAXIMA_PREFIX/bin/maxima" "$@"
