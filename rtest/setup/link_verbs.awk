# link_verbs.awk MANUAL.texi MANUAL.html: in the HTML the name of a verb, wherever it stands as code and is no link yet,
# leads to the verb's entry.
FNR == NR {
  if (sub(/^@deffn {Function} /, "")) verb[$1] = 1
  next
}

{
  line = $0
  result = ""
  while (match(line, /<code>[a-z_0-9]+<\/code>/)) {
    name = substr(line, RSTART + 6, RLENGTH - 13)
    code = substr(line, RSTART, RLENGTH)
    before = substr(line, 1, RSTART - 1)
    anchor = name
    gsub(/_/, "_005f", anchor)
    if (name in verb && before !~ /<a [^>]*>[^<]*$/) code = "<a class=\"verb\" href=\"#index-" anchor "\">" code "</a>"
    result = result before code
    line = substr(line, RSTART + RLENGTH)
  }
  print result line
}
