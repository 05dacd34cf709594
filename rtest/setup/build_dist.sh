#!/bin/sh
# build_dist.sh: packs what is committed into out/anmech-VERSION.tar.gz, one folder anmech-VERSION; and, laid out as
# Maxima's own share directory could take it, into out/anmech-VERSION-share.tar.gz, one folder anmech with the kernel
# inside it.  The same commit gives the same bytes.
set -u
root=$(cd "$(dirname "$0")/../.." && pwd)
out=$root/out
stop() { echo "build_dist.sh: $1" >&2; exit 1; }
cd "$root" || exit 1
[ "$(git rev-parse --show-toplevel 2> /dev/null)" = "$root" ] ||
  stop "this is no checkout: a packed tree is not packed again."
[ -z "$(git status --porcelain --untracked-files=no)" ] || echo "Changes that are not committed are not in it." >&2
version=$(git show HEAD:share/anmech/base/version.mac | sed -n 's/^anmech_version() := "\(.*\)".*/\1/p')
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
mkdir -p "$out"

# The share layout is a commit's tree of its own, so that git packs it just as it packs the whole.
share_tree() {
  GIT_INDEX_FILE=$work/index
  export GIT_INDEX_FILE
  git read-tree --prefix= HEAD:share/anmech && git read-tree --prefix=src/ HEAD:src &&
    git read-tree --prefix=examples/ HEAD:examples &&
    git update-index --add --cacheinfo "100644,$(git rev-parse HEAD:LICENSE),LICENSE" && git write-tree
}

tree=$(share_tree) || stop "the layout for Maxima's share could not be made."
pack() {                                       # pack TREE FOLDER FILE
  git archive --format=tar --mtime="$(git log -1 --format=%cI)" --prefix="$2/" "$1" > "$work/tar" 2> "$work/log" ||
    git archive --format=tar --prefix="$2/" "$1" > "$work/tar" || return 1        # before git 2.40
  gzip -9 -n < "$work/tar" > "$3"
}
pack HEAD "anmech-$version" "$out/anmech-$version.tar.gz" &&
  pack "$tree" anmech "$out/anmech-$version-share.tar.gz" || stop "it could not be packed."
echo "$out/anmech-$version.tar.gz"
echo "$out/anmech-$version-share.tar.gz"
