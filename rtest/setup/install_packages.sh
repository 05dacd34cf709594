#!/bin/sh
# install_packages.sh PACKAGE ...: installs packages of Debian (or a descendant of it) if that needs no password;
# otherwise says in one sentence what to install, and leaves with status 1.
set -u
sentence() {
  if [ "$(uname)" = Darwin ]; then
    renamed='s/ maxima-share / /; s/ gnuplot-nox / gnuplot /; s/ python3-venv / python /'
    command="brew install $(echo " $* " | sed "$renamed")"
  elif command -v apt-get > /dev/null; then
    command="sudo apt-get install $*"
  else
    command="the packages of this system that correspond to Debian's $*"
  fi
  echo "anmech needs software that is missing here: install it with $command, then try again." >&2
  exit 1
}

command -v apt-get > /dev/null || sentence "$@"
if [ "$(id -u)" = 0 ]; then
  sudo=
elif sudo -n true 2> /dev/null; then
  sudo="sudo -n"
else
  sentence "$@"
fi
log=$(mktemp) || exit 1
trap 'rm -f "$log"' EXIT
install() {
  $sudo env DEBIAN_FRONTEND=noninteractive apt-get -q -y -o DPkg::Lock::Timeout=300 install --no-install-recommends "$@"
}
echo "Installing $* ..." >&2
# The lists of packages are fetched only if those at hand do not serve.
install "$@" > "$log" 2>&1 || { $sudo apt-get -q update && install "$@"; } > "$log" 2>&1 ||
  { cat "$log" >&2; sentence "$@"; }
