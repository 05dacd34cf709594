#!/bin/sh
# draw_gallery.sh: those pictures of README.md that are not drawn with the manual, by examples/pictures/gallery.mac.
# The flip map, which takes minutes, is drawn by bench/sweeps.sh.
set -u
here=$(cd "$(dirname "$0")" && pwd)
cd "$here/../.." || exit 1
"$here/run_examples.sh" examples/pictures/gallery.mac > out/gallery.log || { cat out/gallery.log >&2; exit 1; }
cp out/gallery/picture_1.png examples/pictures/portrait.png &&
  cp out/gallery/picture_2.png examples/pictures/work_precision.png &&
  cp out/gallery/picture_3.gif examples/pictures/double_pendulum.gif
