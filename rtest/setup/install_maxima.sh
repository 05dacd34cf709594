#!/bin/sh
# install_maxima.sh: sees to it that there is a Maxima to work with, and gnuplot for its pictures; installs what is
# missing (see install_packages.sh).  When all is there it has looked at a few files, and is silent.  Variable:
# MAXIMA, as for run_maxima.sh; a Maxima chosen by it is taken as it is.
set -u
here=$(dirname "$0")
eval "set -- ${MAXIMA:-maxima}"
if [ "$1" != maxima ] && ! command -v "$1" > /dev/null; then
  echo "MAXIMA names the command $1, and there is no such command." >&2
  exit 1
fi

exists() { [ -e "$1" ]; }

# What is missing, by the names of Debian's packages.  Debian's Maxima comes apart (share/draw is in maxima-share), and
# when it is built on GCL it compiles Lisp by way of C.
missing() {
  compiler=no
  case $(command -v maxima) in
    '')
      [ "$1" != maxima ] || { echo maxima maxima-share; compiler=yes; } ;;
    /usr/bin/maxima | /bin/maxima)
      if exists /var/lib/dpkg/info/maxima.list; then
        exists /usr/share/maxima/*/share/draw || echo maxima-share
        ! exists /usr/lib/maxima/*/binary-gcl || compiler=yes
      fi ;;
  esac
  [ $compiler = no ] || { command -v gcc > /dev/null && exists /usr/include/stdio.h; } || echo gcc libc6-dev
  command -v gnuplot > /dev/null || echo gnuplot-nox
}

packages=$(missing "$1")
[ -z "$packages" ] || "$here/install_packages.sh" $packages
