#!/bin/sh
# check_install.sh: installs the package into an empty home, uses it from another directory, and removes it again.
# Prints one line, and below it what was not as it should be.  Variables: MAXIMA; TALLY, a file to which the numbers
# of checks passed and failed are added.
set -u
here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
home=$work/home
door=$home/.maxima/anmech.mac
mkdir "$home"
cache=${XDG_CACHE_HOME:-$HOME/.cache}          # where the Maximas of check_all.sh are, whatever the home
start=$(date +%s)
passed=0 failed=0 complaints=

check() {                                      # check TEXT COMMAND ...: COMMAND succeeds
  text=$1
  shift
  if "$@"; then
    passed=$((passed + 1))
  else
    failed=$((failed + 1))
    complaints="$complaints  not so: $text
"
  fi
}

install() {
  (unset MAXIMA_USERDIR XDG_DATA_HOME XDG_BIN_HOME
   HOME=$home XDG_CACHE_HOME=$cache "$here/install.sh" "$@") > "$work/log" 2>&1
}
refuses() { ! "$@"; }
files() { (cd "$home" && find . ! -path './.maxima/test-directory-cached*' | sort); }      # that is 5.50's own

# Evaluates an expression in a Maxima that was started in another directory than the package's.
answers() {                                    # answers EXPRESSION VALUE
  USERDIR=$home/.maxima DIRECTORY=$work "$here/run_maxima.sh" --very-quiet \
    --run-string="print(\"answer:\", $1)\$" > "$work/log" 2>&1
  grep -q "^answer: $2 *\$" "$work/log"
}

# Runs a script in the directory of another.
batch() {                                      # batch INPUTS
  echo "$1" > "$work/script.mac"
  (cd "$work" && HOME=$home XDG_CACHE_HOME=$cache MAXIMA_USERDIR=$home/.maxima \
    "$home/.local/bin/anmech_batch" script.mac) > "$work/log" 2>&1
}

# As many binaries as sources, but for the file that is always interpreted.  ECL may have come without the headers that
# its compiler needs: then there are none.
compiled() {
  binaries=$(find "$home/.maxima/binary" -path '*anmech-*' -type f 2> /dev/null | wc -l)
  sources=$(find "$here/../../src" -name '*.lisp' ! -name package.lisp | wc -l)
  [ "$binaries" = "$sources" ] || { [ "$binaries" = 0 ] && answers 'build_info()@lisp_name' ECL; }
}

# One file is installed as another version would have it, while all are compiled: it is compiled again, and it alone.
one_file=numerics/magnification
compiles_one_file() {
  [ "$binaries" = 0 ] && return                # as above
  again=$(find "$home/.maxima/binary" -path '*anmech-*' -type f -newer "$work/changed")
  case $again in
    *"
"*) return 1 ;;
    */$one_file.*) ;;
    *) return 1 ;;
  esac
}

check "it is not there before" answers 'emptyp(errcatch(load("anmech")))' true
files > "$work/before"                         # with what Maxima writes at its first start
check "it installs" install
check "its kernel is compiled" compiled
files > "$work/installed"
check "it loads and works" answers '(load("anmech"), is_zero(x - x))' true
check "nothing is compiled again" [ -z "$(files | comm -13 "$work/installed" -)" ]
check "it works again" answers '(load("anmech"), is_zero(x - x))' true
check "it finds its examples" answers '(load("anmech"), is(length(anmech_example_files()) > 10))' true
command -v makeinfo > /dev/null &&
  check "it finds its manual" answers '(load("anmech"), stringp(anmech_help(open = false)))' true
check "anmech_batch says that all went well" batch 'load("anmech")$ is_zero(x - x);'
check "anmech_batch says that something did not" refuses batch 'load("anmech")$ energy(x);'
check "anmech_batch says so of Lisp, too" refuses batch '?car(5);'
echo "; changed" | tee -a "$home/.local/share/anmech/src/$one_file.lisp" > "$work/changed"
check "it installs again" install
check "it compiles what has changed" compiles_one_file
check "it works after that" answers '(load("anmech"), is_zero(x - x))' true
check "it goes" install --remove
check "it is gone" answers 'emptyp(errcatch(load("anmech")))' true
left=$(files | comm -13 "$work/before" -)
check "nothing is left behind: $left" [ -z "$left" ]

mkdir -p "$home/.maxima"
echo '"a file of the user"$' > "$door"
check "it does not overwrite a user's file" refuses install
check "it does not remove a user's file" refuses install --remove
check "a user's file stays" grep -q "a file of the user" "$door"

printf '%-30s %4d passed %4d failed %8.1f s\n' installation $passed $failed $(($(date +%s) - start))
printf '%s' "$complaints"
[ $failed = 0 ] || sed 's/^/    | /' "$work/log"
[ -z "${TALLY:-}" ] || echo $passed $failed >> "$TALLY"
[ $failed = 0 ]
