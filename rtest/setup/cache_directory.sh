#!/bin/sh
# cache_directory.sh: prints where this checkout keeps what is compiled: a directory of the user's cache, named after the
# place of the checkout, so that two checkouts do not take each other's compiled kernel for theirs.
root=$(cd "$(dirname "$0")/../.." && pwd)
echo "${XDG_CACHE_HOME:-$HOME/.cache}/anmech/$(echo "$root" | cksum | cut -d' ' -f1)"
