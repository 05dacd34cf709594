# Sourced by the measurements that need a peer in Python.  $python has SymPy, SciPy and mpmath; after need_delierium,
# $delierium has delierium and SymPy, and wants Python 3.12.  Both are virtual environments of the user's cache, made at
# first use (Debian: apt-get install python3-venv).
cache=${XDG_CACHE_HOME:-$HOME/.cache}/anmech

# environment NAME PYTHON MODULES PACKAGE..., unless its python already imports the modules
environment() {
  made=$cache/$1 with=$2 modules=$3
  shift 3
  [ -x "$made/bin/python" ] && "$made/bin/python" -c "import $modules" 2> /dev/null && return
  "$with" -m venv "$made" && "$made/bin/python" -m pip install -q "$@" ||
    { echo "bench: python3 with the module venv and access to PyPI are needed for the peers" >&2; exit 1; }
}

environment peers python3 'sympy, scipy, mpmath' sympy==1.14.0 scipy numpy mpmath
python=$cache/peers/bin/python

need_delierium() {
  for recent in "${PYTHON:-python3}" python3.14 python3.13 python3.12 "$HOME"/.pyenv/versions/3.1[2-9]*/bin/python3; do
    "$recent" -c 'import sys; sys.exit(sys.version_info < (3, 12))' 2> /dev/null && break
    recent=
  done
  [ -n "$recent" ] || { echo "bench: delierium needs Python 3.12 (PYTHON=its path)" >&2; exit 1; }
  environment delierium "$recent" 'sympy, delierium' delierium==2.6.0 sympy==1.14.0
  delierium=$cache/delierium/bin/python
}
