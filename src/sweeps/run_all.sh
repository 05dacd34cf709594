#!/bin/sh
# run_all [WORKERS]: computes the chunks that are missing in the folder where it lies, by GNU parallel if it is there,
# else one by one.
set -u
cd "$(dirname "$0")" || exit 1
set -- "${1:-100%}" $(sed -n 's/^points \([0-9]*\) in chunks of \([0-9]*\)$/\1 \2/p' manifest)
[ $# = 3 ] || { echo "the manifest is damaged" >&2; exit 2; }
if command -v flock > /dev/null && (: >> at_work) 2> /dev/null; then
  exec 8>> at_work                                   # a session sees that somebody computes here
  flock -n -s 8
fi
missing() {
  number=1
  while [ $(((number - 1) * $3)) -lt "$2" ]; do
    [ -f "chunks/$(printf 'chunk_%06d' $number)" ] || echo $number
    number=$((number + 1))
  done
}
if parallel --version 2> /dev/null | grep -q GNU; then
  missing "$@" | parallel --will-cite --jobs "$1" sh ./run_chunk
else
  for number in $(missing "$@"); do sh ./run_chunk "$number"; done
fi
[ -z "$(missing "$@")" ]
