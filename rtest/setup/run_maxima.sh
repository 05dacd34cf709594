#!/bin/sh
# run_maxima.sh [options of Maxima]: runs Maxima as tests and examples need it, and leaves with its exit status.
#
# Nobody answers questions (standard input is closed), no maxima-init of the user takes part (MAXIMA_USERDIR and the
# directory for temporary files are new, and removed at the end), messages are in English, and the compiled kernel is
# kept from run to run in the user's cache.  Variables that choose:
#   MAXIMA      the command, perhaps with options: "maxima -l sbcl"      (maxima)
#   TIMEOUT     seconds until Maxima is stopped, with status 124         (600)
#   DIRECTORY   where to run                                             (the present directory)
#   USERDIR     a user directory that is to take part after all          (none)
set -u
eval "set -- ${MAXIMA:-maxima} \"\$@\""
command=$1
shift
case $command in
  */*) command=$(cd "$(dirname "$command")" && pwd)/$(basename "$command") ;;
esac

scratch=$(mktemp -d) || exit 1
trap 'rm -rf "$scratch"' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM
mkdir "$scratch/user"
if [ -n "${USERDIR:-}" ]; then
  MAXIMA_USERDIR=$USERDIR
  unset MAXIMA_OBJDIR
else
  MAXIMA_USERDIR=$scratch/user
  MAXIMA_OBJDIR=${XDG_CACHE_HOME:-$HOME/.cache}/anmech/objects
  export MAXIMA_OBJDIR
fi
# The script of Debian has GCL collect garbage so often that it takes a third of the time.
: "${GCL_GC_ALLOC_MIN:=0.1}" "${GCL_GC_PAGE_MAX:=0.3}" "${GCL_GC_PAGE_THRESH:=0.75}"
export GCL_GC_ALLOC_MIN GCL_GC_PAGE_MAX GCL_GC_PAGE_THRESH
# ECL's begins with a heap so small that collecting takes a sixth of it.
: "${GC_INITIAL_HEAP_SIZE:=256m}"
export GC_INITIAL_HEAP_SIZE
TMPDIR=$scratch
LC_ALL=C.UTF-8
export MAXIMA_USERDIR TMPDIR LC_ALL

limit=
for timeout in timeout gtimeout; do      # the second is its name on macOS
  command -v $timeout > /dev/null && { limit="$timeout --foreground --kill-after=10 ${TIMEOUT:-600}"; break; }
done
cd "${DIRECTORY:-.}" && $limit "$command" "$@" < /dev/null
