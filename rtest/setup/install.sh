#!/bin/sh
# install.sh, install.sh --remove: installs the package for the user who calls it and compiles its kernel, or takes it
# away again.
#
# The tree goes to the user's directory for data, with the examples that demo plays and, if makeinfo is here, the manual
# in HTML, and a file of one line, which
# loads it from there, to Maxima's user directory; the command anmech_batch to the user's directory for programs.  The
# tree must not lie in Maxima's user directory: 5.50 searches that with all that is below it before its own packages,
# and so a file of ours called gauss.lisp would hide a file of Maxima's.
# Variables: MAXIMA_USERDIR (what Maxima says), MAXIMA (maxima), XDG_DATA_HOME (~/.local/share), XDG_BIN_HOME
# (~/.local/bin).
set -u
root=$(cd "$(dirname "$0")/../.." && pwd)
tree=${XDG_DATA_HOME:-$HOME/.local/share}/anmech
command=${XDG_BIN_HOME:-$HOME/.local/bin}/anmech_batch
mark="Written by anmech's make install; make uninstall removes it."

# Where Maxima looks for a user's files; the usual place, if there is no Maxima yet.
user_directory() {
  eval "set -- ${MAXIMA:-maxima}"
  answer=$("$@" --very-quiet --run-string='print(sconcat("user directory: ", maxima_userdir, "."))$' \
             < /dev/null 2> /dev/null | sed -n 's/^user directory: \(.*\)\. *$/\1/p')
  echo "${answer:-$HOME/.maxima}"
}

userdir=${MAXIMA_USERDIR:-$(user_directory)}
door=$userdir/anmech.mac
ours() { [ ! -e "$door" ] || grep -q "$mark" "$door"; }
stop() { echo "$1" >&2; exit 1; }

# mkdir -p that prints what it makes, outermost first: this is what is removed at the end if it is empty then.
make_directory() {
  [ -d "$1" ] || { make_directory "$(dirname "$1")" && mkdir "$1" && echo "$1"; }
}

remove() {
  # The compiled kernel, which is kept among Maxima's own objects.
  find "$userdir/binary" -type d -name 'anmech-*' -prune -exec rm -rf {} + 2> /dev/null
  find "$userdir/binary" -depth -type d -empty -exec rmdir {} \; 2> /dev/null
  made=$(sed '1!G;h;$!d' "$tree/made" 2> /dev/null)       # innermost first
  rm -rf "$tree" "$door"
  [ ! -L "$command" ] || rm -f "$command"
  [ -z "$made" ] || echo "$made" | while read -r directory; do rmdir "$directory" 2> /dev/null; done
  echo "anmech is removed."
}

# The kernel, for this Maxima; for another one it is compiled at its first use.  A binary counts as fresh when it is
# younger than the sources, in seconds.
compile_kernel() {
  eval "set -- ${MAXIMA:-maxima}"
  command -v "$1" > /dev/null || return
  sleep 1
  "$@" --very-quiet --run-string='load("anmech")$ anmech_compile_kernel()$' < /dev/null > /dev/null 2>&1
}

# Files of the kernel that are as they were keep their dates, and so what was compiled of them.
keep_dates() {                                 # keep_dates BEFORE NOW
  (cd "$1" && find . -type f) | while read -r file; do
    ! cmp -s "$1/$file" "$2/$file" || touch -r "$1/$file" "$2/$file"
  done
}

install() {
  before=$(mktemp -d) || exit 1
  trap 'rm -rf "$before"' EXIT
  [ ! -d "$tree/src" ] || mv "$tree/src" "$before"
  made=$(cat "$tree/made" 2> /dev/null; make_directory "$(dirname "$tree")"; make_directory "$userdir"
         make_directory "$(dirname "$command")")
  rm -rf "$tree" && mkdir "$tree" &&
    cp -R "$root/share" "$root/src" "$root/examples" "$root/bin" "$root/README.md" "$root/LICENSE" "$tree/" &&
    { [ -e "$command" ] && [ ! -L "$command" ] || ln -sf "$tree/bin/anmech_batch" "$command"; } &&
    printf '%s' "${made:+$made
}" > "$tree/made" &&
    printf '/* %s */\nload("%s/share/anmech/anmech.mac")$\n' "$mark" "$tree" > "$door" ||
    stop "anmech could not be installed."
  [ ! -d "$before/src" ] || keep_dates "$before/src" "$tree/src"
  "$root/rtest/setup/build_manual.sh" html "$tree/doc" 2> /dev/null ||
    echo "The manual in HTML is left out: it takes makeinfo, of the package texinfo."
  compile_kernel
  version=$(sed -n 's/^anmech_version() := "\(.*\)".*/\1/p' "$tree/share/anmech/base/version.mac")
  echo "anmech $version is installed in $tree; load(\"anmech\") finds it by way of $door."
  echo "In it demo(\"anmech\") begins; the examples are in $tree/examples; scripts are run by $command."
}

ours || stop "$door was not written by make install: it stays as it is, and nothing was changed."
case ${1:-} in
  --remove) remove ;;
  *) install ;;
esac
