# cached_maxima.sh: read by the scripts that keep a Maxima of their own in the user's cache, maxima_NAME.sh.
# shellcheck shell=sh
#
#   made_once NAME TEXT     sets $place, the directory NAME in the cache; unless it is there, says TEXT and runs the
#                           function make_it, which creates it; if that fails, shows the end of what it wrote and
#                           leaves
#
# To have one made anew, remove its directory.
cache=${XDG_CACHE_HOME:-$HOME/.cache}/anmech

made_once() {
  place=$cache/$1
  [ -e "$place" ] && return
  echo "$2 into $place ..." >&2
  mkdir -p "$cache"
  set +e                                             # in "make_it || ..." the shell would not stop at errors
  (set -e; make_it) > "$cache/$1.log" 2>&1
  set -e
  [ -e "$place" ] || {
    tail -n 20 "$cache/$1.log" >&2
    echo "$2 failed; all that was said is in $cache/$1.log." >&2
    exit 1
  }
}
