#!/bin/sh
# maxima_sbcl.sh [options of Maxima]: the distribution's version of Maxima, on SBCL.  At its first use it is built
# from the distribution's source package into the user's cache (a minute or two, 110 MB).
set -eu
. "$(dirname "$0")/cached_maxima.sh"

make_it() {
  command -v sbcl > /dev/null && command -v gcc > /dev/null && command -v make > /dev/null ||
    "$(dirname "$0")/install_packages.sh" sbcl gcc make
  work=$(TMPDIR=$cache mktemp -d)
  trap 'rm -rf "$work"' EXIT
  cd "$work"
  # A package index of our own, made of the system's sources read as sources of source packages; the system's stays as
  # it is.
  mkdir -p sources lists/partial
  for list in /etc/apt/sources.list.d/*.sources; do
    [ ! -e "$list" ] || sed 's/^Types:.*/Types: deb-src/' "$list" > "sources/$(basename "$list")"
  done
  for list in /etc/apt/sources.list /etc/apt/sources.list.d/*.list; do
    [ ! -e "$list" ] || sed -n 's/^deb /deb-src /p' "$list" > "sources/$(basename "$list" .list).list"
  done
  apt="apt-get -q -o Dir::Etc::sourcelist=/dev/null -o Dir::Etc::sourceparts=$work/sources"
  apt="$apt -o Dir::State::lists=$work/lists"
  $apt update || true                                # one source that cannot be reached does not matter
  $apt source --download-only maxima || true         # nor do Debian's own changes: the archive of the authors is enough
  tar xf maxima_*.orig.tar.gz
  cd maxima-*/
  ./configure --prefix="$place" --enable-sbcl --disable-build-docs
  make -C src
  make install DESTDIR="$work/stage"
  cp doc/info/maxima.info* doc/info/maxima-index.lisp "$work/stage$place/share/info/"
  mv "$work/stage$place" "$place"
}

made_once maxima-sbcl "Building Maxima on SBCL"
# SBCL's own limit of the heap is 1 GB in Debian.
exec "$place/bin/maxima" -X '--dynamic-space-size 4GB --control-stack-size 64MB' "$@"
