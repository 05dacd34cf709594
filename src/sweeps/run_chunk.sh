#!/bin/sh
# run_chunk NUMBER ...: computes these chunks of the sweep in whose folder it lies, and leaves with 0 if all are there
# then.  It takes a Maxima (MAXIMA, or maxima), and the package that lies in the folder, of which a copy is kept in the
# user's cache, so that it is compiled once on each host; or that in ANMECH_HOME.
set -u
folder=$(cd "$(dirname "$0")" && pwd) || exit 1
cd "$folder" || exit 1
numbers=
for number; do
  number=$(expr "$number" + 0) || exit 2
  numbers=${numbers:+$numbers,}$number
done
[ -n "$numbers" ] || exit 2

home=${ANMECH_HOME:-}
if [ -z "$home" ]; then
  mark=$(sed -n 's/^package //p' manifest)
  case $mark in *[!0-9a-f]* | '') echo "the manifest is damaged" >&2; exit 2 ;; esac
  cache=${XDG_CACHE_HOME:-$HOME/.cache}/anmech/packages
  home=$cache/$mark
  if [ ! -d "$home" ]; then
    mkdir -p "$cache" && cp -R package "$home.$$" && { mv -T "$home.$$" "$home" 2> /dev/null || rm -rf "$home.$$"; }
    [ -d "$home" ] || home=$folder/package
  fi
fi

scratch=$(mktemp -d) || exit 1
trap 'rm -rf "$scratch"' EXIT
trap 'exit 143' TERM
trap 'exit 130' INT
: "${MAXIMA_OBJDIR:=${XDG_CACHE_HOME:-$HOME/.cache}/anmech/objects}"
MAXIMA_USERDIR=$scratch
TMPDIR=$scratch
export MAXIMA_USERDIR MAXIMA_OBJDIR TMPDIR
mkdir -p chunks
task="load(\"$home/share/anmech/anmech.mac\")\$ anmech_need(\"sweeps/jobs\", \"sweeps/limits.lisp\")\$"
task="$task anmech_as_verb(sweep, anmech_work_on, \"$folder\", [$numbers])\$ quit()\$"
eval "${MAXIMA:-maxima}" --very-quiet '"--run-string=$task"' < /dev/null > "$scratch/log" 2>&1
for number in $(echo "$numbers" | tr , ' '); do
  file=$(printf 'chunks/chunk_%06d' "$number")
  [ -f "$file" ] || { grep -v '^ *$' "$scratch/log" | tail -n 5 >&2; exit 1; }
done
exit 0
