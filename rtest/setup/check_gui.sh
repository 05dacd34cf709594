#!/bin/sh
# check_gui.sh [FILE ...]: opens worksheets in wxMaxima, on a display that nobody sees, and evaluates all their cells;
# by default all of examples/.  wxMaxima leaves with status 0 when a worksheet came to its end; after an error, or a
# question, it stays open, so that the time limit is a failure.  Its first start takes a minute or two, for it reads
# Maxima's manual.  Status 0 if all came to their end.
# Variables: TIMEOUT, seconds for a worksheet (600); PICTURES, a folder for pictures of the window, one each ten
# seconds.
set -u
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
missing=
command -v wxmaxima > /dev/null || missing="wxmaxima"
command -v xvfb-run > /dev/null || missing="$missing xvfb xauth"
[ -z "${PICTURES:-}" ] || command -v import > /dev/null || missing="$missing imagemagick"
[ -z "$missing" ] || "$here/install_packages.sh" $missing || exit 1

work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM
mkdir "$work/user"
printf 'file_search_maxima : cons("%s/share/anmech/$$$.mac", file_search_maxima)$\n' "$root" \
  > "$work/user/maxima-init.mac"
# What wxMaxima has read of Maxima's manual before.
[ ! -e "$HOME/.maxima/manual_anchors.xml" ] || cp "$HOME/.maxima/manual_anchors.xml" "$work/user"
export MAXIMA_USERDIR="$work/user" MAXIMA_OBJDIR="${XDG_CACHE_HOME:-$HOME/.cache}/anmech/objects"

# wxMaxima writes into the worksheet that it opens: it gets a copy.  The pictures are taken inside of its display.
open_worksheet() {                             # open_worksheet COPY NAME
  if [ -n "${PICTURES:-}" ]; then
    k=0
    while sleep 10 && import -window root "$PICTURES/$2_$k.png"; do k=$((k + 1)); done &
    camera=$!
  fi
  timeout --kill-after=10 "${TIMEOUT:-600}" wxmaxima --exit-on-error --pipe -b "$1"
  left=$?
  [ -z "${PICTURES:-}" ] || kill $camera
  return $left
}
if [ "${1:-}" = --inside ]; then
  shift
  open_worksheet "$@"
  exit
fi

cd "$root" || exit 1
[ -z "${PICTURES:-}" ] || { mkdir -p "$PICTURES"; PICTURES=$(cd "$PICTURES" && pwd); export PICTURES; }
passed=0 failed=0
[ $# -gt 0 ] || set -- examples/*.wxm
for worksheet; do
  name=$(basename "$worksheet" .wxm)
  cp "$worksheet" "$work/$name.wxm" || exit 1
  start=$(date +%s)
  if xvfb-run -a -s "-screen 0 1280x1600x24" "$here/check_gui.sh" --inside "$work/$name.wxm" "$name" > "$work/log" 2>&1
  then passed=$((passed + 1)) verdict=ok
  else failed=$((failed + 1)) verdict=failed
  fi
  printf '%-44s %13s %8.1f s\n' "$worksheet" $verdict $(($(date +%s) - start))
  [ $verdict = ok ] || tail -n 15 "$work/log" | sed 's/^/    | /'
done
echo "$passed passed, $failed failed"
[ $failed = 0 ]
