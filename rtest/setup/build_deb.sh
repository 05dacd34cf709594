#!/bin/sh
# build_deb.sh: makes out/anmech_VERSION-1_all.deb, a package of Debian for the Maxima that Debian has here: the tree in
# /usr/share/anmech, a file of one line where that Maxima looks, the command anmech_batch with its page, the manual for
# info and in HTML, which anmech_help() shows.  The kernel is compiled for each user at its first use.  Variables:
# DEBFULLNAME and DEBEMAIL, the maintainer.
set -u
root=$(cd "$(dirname "$0")/../.." && pwd)
stop() { echo "build_deb.sh: $1" >&2; exit 1; }
command -v dpkg-deb > /dev/null || stop "dpkg-deb, which makes packages of Debian, is not here."
version=$(sed -n 's/^anmech_version() := "\(.*\)".*/\1/p' "$root/share/anmech/base/version.mac")
maxima=$(dpkg-query -W -f '${Version}' maxima 2> /dev/null | sed 's/^[0-9]*://; s/[-+~].*//')
[ -n "$maxima" ] || stop "the package is made for Debian's Maxima, which is not installed: make ready."
next=${maxima%.*}.$((${maxima##*.} + 1))
maintainer="${DEBFULLNAME:-The anmech authors} <${DEBEMAIL:-anmech@localhost}>"
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
umask 022
tree=$work/tree
data=$tree/usr/share
documents=$data/doc/anmech
mkdir -p "$tree/DEBIAN" "$tree/usr/bin" "$data/anmech/share" "$documents" "$data/man/man1" "$data/info" \
  "$data/maxima/$maxima/share/contrib" "$root/out" || exit 1

# What make install copies.  The licence is Debian's own copy.
cp -R "$root/share/anmech" "$data/anmech/share/" &&
  cp -R "$root/src" "$root/examples" "$root/bin" "$data/anmech/" || exit 1
find "$data/anmech" -type f -exec chmod 644 {} +
find "$data/anmech" -type f \( -path '*/bin/*' -o -name '*.sh' \) -exec chmod 755 {} +
printf '/* anmech, as Debian has it. */\nload("/usr/share/anmech/share/anmech/anmech.mac")$\n' \
  > "$data/maxima/$maxima/share/contrib/anmech.mac"
ln -s ../share/anmech/bin/anmech_batch "$tree/usr/bin/anmech_batch"
gzip -9 -n < "$root/share/anmech/anmech.info" > "$data/info/anmech.info.gz"
cp "$root/README.md" "$documents/"
"$root/rtest/setup/build_manual.sh" html "$documents/html" ||
  stop "the manual in HTML takes makeinfo, of the package texinfo."
ln -s ../doc/anmech/html "$data/anmech/doc" || exit 1
gzip -9 -n < "$root/CHANGES.md" > "$documents/changelog.gz"
printf 'anmech (%s-1) unstable; urgency=medium\n\n  * Version %s; changelog.gz says what is new.\n\n -- %s  %s\n' \
  "$version" "$version" "$maintainer" "$(LC_ALL=C date -R -r "$root/CHANGES.md")" |
  gzip -9 -n > "$documents/changelog.Debian.gz"

cat > "$documents/copyright" << END
Format: https://www.debian.org/doc/packaging-manuals/copyright-format/1.0/
Upstream-Name: anmech

Files: *
Copyright: 2026 the anmech authors
License: GPL-2.0-or-later
 This package is free software; you can redistribute it and/or modify it under the terms of the GNU General Public
 License as published by the Free Software Foundation; either version 2 of the License, or (at your option) any later
 version.
 .
 On Debian systems, the text of version 2 is in /usr/share/common-licenses/GPL-2.
END

# The comment at the head of the command is its page.
{ printf '.TH ANMECH_BATCH 1\n.SH NAME\nanmech_batch \\- run scripts and worksheets of Maxima that use anmech\n'
  printf '.SH SYNOPSIS\n.B anmech_batch\n.I FILE ...\n.SH DESCRIPTION\n'
  sed -n '2,/^[^#]/ { s/^# \{0,1\}//p; }' "$root/bin/anmech_batch" | sed 's/-/\\-/g'
} | gzip -9 -n > "$data/man/man1/anmech_batch.1.gz"

cat > "$tree/DEBIAN/control" << END
Package: anmech
Version: $version-1
Architecture: all
Maintainer: $maintainer
Installed-Size: $(du -sk "$tree/usr" | cut -f1)
Depends: maxima (>= $maxima), maxima (<< $next~), maxima-share, gnuplot-nox | gnuplot, gcc, libc6-dev
Suggests: wxmaxima, parallel
Section: math
Priority: optional
Description: analytical mechanics in Maxima
 For systems that are stated by a Lagrangian with constraints, a Hamiltonian, a
 Birkhoffian with its Birkhoff functions, or as equations of first order: the
 equations of motion in every classical form, all their symmetries and the
 conserved quantities, reductions, inverse problems and variational principles;
 motions by numbers, with an estimate of their error, and their pictures.
END
(cd "$tree" && find usr -type f | LC_ALL=C sort | xargs md5sum) > "$tree/DEBIAN/md5sums"
deb=$root/out/anmech_$version-1_all.deb
dpkg-deb --root-owner-group --build "$tree" "$deb" > "$work/log" 2>&1 ||
  { cat "$work/log" >&2; stop "dpkg-deb failed."; }
echo "$deb"
