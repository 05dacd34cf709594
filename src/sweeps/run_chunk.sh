#!/bin/sh
# run_chunk NUMBER ...: computes these chunks of the sweep in whose folder it lies, and leaves with 0 if all are there
# then.  It takes a Maxima (MAXIMA, or maxima), and the package that lies in the folder, of which a copy is kept in the
# user's cache, so that it is compiled once on each host, by whoever comes first, while the others wait; or that in
# ANMECH_HOME.  If ANMECH_STARTER is a process, it ends with that: the session that started it may be gone.
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
compiled=
if [ -z "$home" ]; then
  mark=$(sed -n 's/^package //p' manifest)
  case $mark in *[!0-9a-f]* | '') echo "the manifest is damaged" >&2; exit 2 ;; esac
  cache=${XDG_CACHE_HOME:-$HOME/.cache}/anmech/packages
  home=$cache/$mark
  if [ ! -d "$home" ]; then
    mkdir -p "$cache" && cp -R package "$home.$$" && { mv -T "$home.$$" "$home" 2> /dev/null || rm -rf "$home.$$"; }
    [ -d "$home" ] || home=$folder/package
  fi
  compiled=$cache/$mark.$(printf %s "${MAXIMA:-maxima}" | cksum | cut -d' ' -f1)
fi

# Of the session's environment, which Slurm hands on: its folder may be gone, or be on another host, and that GCL has
# arranged its memory holds for its own children alone.
[ -d "${TMPDIR:-/tmp}" ] || unset TMPDIR
unset GCL_UNRANDOMIZE
scratch=$(mktemp -d) || exit 1
worker=
watcher=
guard=
# A process and what it has started, in whatever groups.
family() {
  echo "$1"
  ps -A -o pid= -o ppid= | awk -v top="$1" '
    { parent[$1] = $2 }
    END { for (one in parent) { above = one
            while (above + 0 > 1 && above != top) above = parent[above]
            if (above == top) print one } }'
}
end() {
  { kill -9 $guard $watcher ${worker:+$(family $worker)}; rm -rf "$scratch"; } 2> /dev/null
}
trap end EXIT
trap 'exit 143' TERM
trap 'exit 130' INT
trap 'exit 129' HUP

# The file at_work is locked as long as somebody computes here: by the starter, or else by this.
if [ -n "${ANMECH_STARTER:-}" ]; then
  kill -0 "$ANMECH_STARTER" || exit 1
  { while kill -0 "$ANMECH_STARTER"; do sleep 1; done; kill $$; } < /dev/null > /dev/null 2>&1 8>&- &
  guard=$!
elif command -v flock > /dev/null && (: >> at_work) 2> /dev/null; then
  exec 8>> at_work
  flock -n -s 8
fi
: "${MAXIMA_OBJDIR:=${XDG_CACHE_HOME:-$HOME/.cache}/anmech/objects}"
MAXIMA_USERDIR=$scratch
TMPDIR=$scratch
export MAXIMA_USERDIR MAXIMA_OBJDIR TMPDIR
mkdir -p chunks

# A name as what stands in a string of Maxima's.
in_string() { printf %s "$1" | sed 's/[\\"]/\\&/g'; }
ln -s "$folder" "$scratch/job"
job=$(in_string "$scratch/job")

# A Maxima that calls this function of the package's, which tells in the file state that it begins and that it has
# written; $limit seconds after it has begun it is killed.  To it the folder is a link, however that is called: some
# names mean something to Maxima or its Lisp.
maxima_does() {
  task="load(\"$(in_string "$home")/share/anmech/anmech.mac\")\$"
  task="$task anmech_need(\"sweeps/jobs\", \"sweeps/limits.lisp\")\$"
  task="$task anmech_as_verb(sweep, $1, \"$(in_string "$scratch")/state\")\$ quit()\$"
  rm -f "$scratch/state" "$scratch/late"
  eval "exec ${MAXIMA:-maxima}" --very-quiet '"--run-string=$task"' < /dev/null > "$scratch/log" 2>&1 &
  worker=$!
  [ -z "$limit" ] || {
    seconds=0
    while kill -0 $worker && [ $seconds -lt "$limit" ]; do
      sleep 1
      [ ! -e "$scratch/state" ] || seconds=$((seconds + 1))
    done
    kill -0 $worker && ! written && : > "$scratch/late" && kill -9 $worker
  } < /dev/null > /dev/null 2>&1 8>&- 9>&- &
  watcher=$!
  wait $worker 2> /dev/null
  worker=
  kill $watcher 2> /dev/null
  watcher=
}

written() { grep -q '^written' "$scratch/state" 2> /dev/null; }

# Chunks of one case with a limit of time, which most of what takes long keeps to by itself: what does not, is ended.
limit=$(sed -n 's/^limit \([0-9]*\)$/\1/p' manifest)
[ -z "$limit" ] || { limit=$((limit + 5)); numbers=$(echo "$numbers" | tr , ' '); }

# The lock goes with the process that holds it, however that ends.
[ -z "$compiled" ] || [ -e "$compiled" ] || ! command -v flock > /dev/null || { exec 9> "$compiled.lock" && flock 9; }
[ -z "$compiled" ] || [ ! -e "$compiled" ] || exec 9>&-
failed=0
for some in $numbers; do
  maxima_does "anmech_work_on, \"$job\", [$some]"
  [ ! -e "$scratch/late" ] || maxima_does "anmech_give_up_on, \"$job\", $some"
  written || { failed=1; grep -v '^ *$' "$scratch/log" | tail -n 5 >&2; }
done
[ -z "$compiled" ] || [ $failed = 1 ] || : > "$compiled"
exit $failed
