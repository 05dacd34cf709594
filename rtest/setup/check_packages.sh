#!/bin/sh
# check_packages.sh: packs the project as make dist and make deb do, and uses what came of it: the packed tree and the
# layout for Maxima's share from where they were unpacked; the package of Debian when lintian found nothing, installed
# and removed again (as root, or with sudo that asks for no password).  Prints one line, and below it what was not as it
# should be.
set -u
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
start=$(date +%s)
passed=0 failed=0
: > "$work/log"

check() {                                      # check TEXT COMMAND ...: COMMAND succeeds
  text=$1
  shift
  if "$@" > "$work/said" 2>&1; then
    passed=$((passed + 1))
  else
    failed=$((failed + 1))
    { echo "  not so: $text"; sed 's/^/    | /' "$work/said"; } >> "$work/log"
  fi
}
refuses() { ! "$@"; }

# Whether an anmech answers that is loaded by LOAD: its kernel, a module, and the manual.
answers() {                                    # answers LOAD
  DIRECTORY=$work "$here/run_maxima.sh" --very-quiet --run-string="load(\"$1\")\$ coordinates([x])\$
    print(\"answer:\", is_zero(x - x), energy(lagrange_system(diff(x,t)^2/2, [x])))\$ describe(\"energy\", exact)\$" \
    > "$work/answer" 2>&1
  cat "$work/answer"
  grep -q '^answer: true' "$work/answer" && grep -q 'energy (' "$work/answer"
}
shows_manual() {
  "$here/run_maxima.sh" --very-quiet --run-string="load(\"anmech\")\$ print(anmech_help(about = energy))\$" \
    > "$work/help" 2>&1
  page=$(sed -n 's,^ *file://\(.*\)#index-energy *$,\1,p' "$work/help")
  cat "$work/help"
  [ -n "$page" ] && grep -q 'id="index-energy"' "$page"
}
as_root() { if [ "$(id -u)" = 0 ]; then "$@"; else sudo -n "$@"; fi; }
same_bytes() { "$here/build_dist.sh" > /dev/null && cmp "$work/first.tar.gz" "$packed"; }

version=$(sed -n 's/^anmech_version() := "\(.*\)".*/\1/p' "$root/share/anmech/base/version.mac")
packed=$root/out/anmech-$version.tar.gz
share=$root/out/anmech-$version-share.tar.gz
deb=$root/out/anmech_$version-1_all.deb

check "make dist packs" "$here/build_dist.sh"
cp "$packed" "$work/first.tar.gz"
check "it packs the same bytes again" same_bytes
check "the packed tree unpacks" tar -xzf "$packed" -C "$work"
check "it is used from there" answers "$work/anmech-$version/share/anmech/anmech.mac"
check "the layout for Maxima's share unpacks" tar -xzf "$share" -C "$work"
check "it is used from there" answers "$work/anmech/anmech.mac"

if command -v dpkg-deb > /dev/null; then
  command -v lintian > /dev/null || "$here/install_packages.sh" lintian
  check "make deb makes a package" env DEBEMAIL=anmech@debian.org "$here/build_deb.sh"
  check "lintian finds nothing" lintian --fail-on error,warning --suppress-tags initial-upload-closes-no-bugs "$deb"
  if [ "$(id -u)" = 0 ] || sudo -n true 2> /dev/null; then
    check "it installs" as_root dpkg -i "$deb"
    check "it is used by its name" answers anmech
    check "anmech_help() has the manual in HTML" shows_manual
    echo 'load("anmech")$ is_zero(x - x);' > "$work/script.mac"
    check "anmech_batch is a command" anmech_batch "$work/script.mac"
    check "it has a page" man -w anmech_batch
    check "it goes" as_root dpkg -P anmech
    check "nothing is left behind" refuses ls -d /usr/share/anmech /usr/bin/anmech_batch /usr/share/doc/anmech
  fi
fi

printf '%-30s %4d passed %4d failed %8.1f s\n' packages $passed $failed $(($(date +%s) - start))
cat "$work/log"
[ $failed = 0 ]
