#!/bin/sh
# build_manual.sh: computes the examples of the manual and of README.md anew, lists the book's sections and the terms,
# and makes the manual as Maxima reads it, with its index; then, in doc/, as HTML and as PDF.  Status 0 only if every
# step came to its end, which Maxima's own exit status does not tell.
# build_manual.sh html DIRECTORY: only the HTML, with its pictures, into that directory, where makeinfo is at hand.
# build_manual.sh pages: only what is in doc/.
# Variable: FILES, as "tutorial.texi README.md": only the examples of these are computed.
set -u
here=$(cd "$(dirname "$0")" && pwd)
cd "$here/../.." || exit 1
source=share/anmech/anmech.texi
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT

build() {                                      # build STEP FILE CALL
  "$here/run_maxima.sh" --very-quiet \
    --run-string='load("share/anmech/anmech.mac")$ anmech_need("session/'"$2"'.lisp")$ '"$3"'$' > "$work/log" 2>&1
  grep -q "^The manual's $1.*: done" "$work/log" || { cat "$work/log" >&2; return 1; }
}

# Outputs are formulas in it.  The name of a verb, wherever it stands as code, leads to the verb's entry.
html() {                                       # html DIRECTORY
  mkdir -p "$1/examples/pictures" "$work/html" && cp examples/pictures/*.png "$1/examples/pictures/" &&
    build formulas manual_formulas "anmech_write_formulas(\"$work/html\")" &&
    makeinfo --html --no-split -c TOP_NODE_UP_URL= --css-include=share/anmech/manual.css -I . \
             -o "$work/manual.html" "$work/html/anmech.texi" &&
    awk -f "$here/link_verbs.awk" "$source" "$work/manual.html" > "$1/anmech.html"
}

# TeX has no fonts for what is meant for HTML alone, and cannot leave it out within tables.
pdf() {                                        # pdf DIRECTORY
  for file in share/anmech/*.texi; do
    sed 's/@inlineraw{html, [^}]*}//g' "$file" > "$work/$(basename "$file")"
  done
  ln -s "$PWD/examples" "$work/examples"
  (cd "$work" && texi2dvi --pdf --batch --quiet -o manual.pdf anmech.texi) > "$work/log" 2>&1 &&
    cp "$work/manual.pdf" "$1/anmech.pdf" || { tail -n 20 "$work/log" >&2; return 1; }
}

pages() {
  html doc || exit 1
  { command -v texi2dvi && command -v pdftex; } > /dev/null ||
    "$here/install_packages.sh" texinfo texlive-base texlive-plain-generic || exit 1
  pdf doc || exit 1
  echo "The manual is doc/anmech.html and doc/anmech.pdf."
}

if [ "${1:-}" = html ]; then
  command -v makeinfo > /dev/null && html "$2"
  exit
fi
command -v makeinfo > /dev/null || "$here/install_packages.sh" texinfo || exit 1
[ "${1:-}" != pages ] || { pages; exit; }
[ -f doc/anmech.html ] || html doc || exit 1   # the example of anmech_help says where it is
build outputs manual "anmech_build_manual(\"outputs${FILES:+ $FILES}\")" || exit 1
"$here/run_maxima.sh" --very-quiet --run-string='load("rtest/run.lisp")$ load("share/anmech/anmech.mac")$
  load("rtest/sections.lisp")$ load("rtest/terms.lisp")$ list_terms()$ list_sections();' > "$work/log" 2>&1
grep -q "done" "$work/log" || { cat "$work/log" >&2; exit 1; }
makeinfo --no-split -o share/anmech/anmech.info "$source" || exit 1
build index manual 'anmech_build_manual("index")' || exit 1
pages
