# Sourced by the measurements that need a peer in Python: $python has SymPy, SciPy and mpmath, in a virtual environment
# of the user's cache, made at first use (Debian: apt-get install python3-venv).
python=${XDG_CACHE_HOME:-$HOME/.cache}/anmech/peers/bin/python
if ! [ -x "$python" ] || ! "$python" -c 'import sympy, scipy, mpmath' 2> /dev/null; then
  python3 -m venv "${python%/bin/python}" &&
  "$python" -m pip install -q sympy==1.14.0 scipy numpy mpmath ||
    { echo "bench: python3 with the module venv and access to PyPI are needed for the peers" >&2; exit 1; }
fi
