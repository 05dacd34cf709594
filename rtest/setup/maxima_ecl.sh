#!/bin/sh
# maxima_ecl.sh [options of Maxima]: Maxima 5.50.0 on ECL, as the Python package index has it for Linux and macOS.  At its
# first use it is installed into the user's cache (remove the directory to install it anew).
set -eu
cache=${XDG_CACHE_HOME:-$HOME/.cache}/anmech
place=$cache/maxima-ecl

install() {
  python3 -c 'import ensurepip' || "$(dirname "$0")/install_packages.sh" python3-venv
  rm -rf "$place.new"
  python3 -m venv "$place.new"
  # Not by the script pip, which would hold the name of the directory.
  "$place.new/bin/python3" -m pip install --no-deps --disable-pip-version-check \
    passagemath-maxima==10.8.13 passagemath-ecl==10.8.13
  mv "$place.new" "$place"
}

if [ ! -e "$place" ]; then
  echo "Installing Maxima 5.50 on ECL into $place ..." >&2
  mkdir -p "$cache"
  set +e                                             # in "install || ..." the shell would not stop at errors
  (set -e; install) > "$cache/maxima-ecl.log" 2>&1
  set -e
  [ -e "$place" ] || {
    tail -n 20 "$cache/maxima-ecl.log" >&2
    echo "Maxima on ECL could not be installed; all that was said is in $cache/maxima-ecl.log." >&2
    exit 1
  }
fi
MAXIMA_PREFIX=$(echo "$place"/lib/python3.*/site-packages/sage_wheels)
ECLDIR=$(echo "$MAXIMA_PREFIX"/lib/ecl-*)/           # without the slash at its end ECL does not start
export MAXIMA_PREFIX ECLDIR
exec "$MAXIMA_PREFIX/bin/maxima" "$@"
