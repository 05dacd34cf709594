#!/bin/sh
# draw_gallery.sh: those pictures of README.md that are not drawn with the manual, by pictures/gallery.mac.
set -u
here=$(cd "$(dirname "$0")" && pwd)
cd "$here/../.." || exit 1
"$here/run_examples.sh" pictures/gallery.mac > out/gallery.log || { cat out/gallery.log >&2; exit 1; }
cp out/gallery/picture_1.png pictures/portrait.png &&
  cp out/gallery/picture_2.png pictures/work_precision.png &&
  cp out/gallery/picture_3.gif pictures/double_pendulum.gif
