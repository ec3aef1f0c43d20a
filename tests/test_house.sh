#!/bin/sh
# The house: who includes whom, who prints, how large a file is, that every energy has a reference, that headers stand
# alone in C and in C++, and that the repository knows no machine. $1 is the build folder.
source=${HG_SOURCE:-$(dirname "$0")/..} failed=0
cd "$source" || exit 1
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT

check() { # NAME: good when the log is empty
    if [ -s "$work/log" ]; then echo "not ok $1"; sed 's/^/    /' "$work/log"; failed=1; else echo "ok $1"; fi
}

if git rev-parse --git-dir >/dev/null 2>&1; then git ls-files --cached --others --exclude-standard >"$work/files"
else find . -type f ! -path './.git/*' ! -path './build*' ! -path './out/*' ! -path './bare-out/*' | sed 's|^\./||' >"$work/files"; fi
sort -u "$work/files" | while read -r file; do [ -f "$file" ] && echo "$file"; done >"$work/there"
code=$(grep -E '\.(c|h|inc)$' "$work/there")
library=$(echo "$code" | grep -E '^(base|tensor|geometry|autograd|hairloss|models|scene|train|solvers|tasks|export)/' | grep -vE '/generate_[a-z]*\.c$')

# Floors, ground first; folders of one floor do not know each other.
# shellcheck disable=SC2086
awk '
    BEGIN { split("base=0 tensor=1 geometry=2 autograd=2 hairloss=3 models=3 scene=3 train=4 solvers=4 tasks=5 export=6 cli=7", pairs, " ")
            for (i in pairs) { split(pairs[i], pair, "="); floor[pair[1]] = pair[2] } }
    /^[ \t]*#[ \t]*include[ \t]*"/ {
        split(FILENAME, here, "/"); path = $0; sub(/^[^"]*"/, "", path); sub(/".*/, "", path); split(path, there, "/")
        if (path == "hairgrad.h" && here[1] != "cli") { print FILENAME ":" FNR ": includes hairgrad.h, which includes everything"; next }
        if (!(there[1] in floor) || index(path, "/") == 0) { if (path !~ /^(onnx\.pb-c\.h|hairgrad\.h)$/) print FILENAME ":" FNR ": \"" path "\" is not a path from the root"; next }
        if (here[1] != there[1] && floor[there[1]] >= floor[here[1]]) print FILENAME ":" FNR ": " here[1] " includes from " there[1] ", which is no floor below it"
    }' $library $(echo "$code" | grep '^cli/') >"$work/log"
check "floors"

# Nothing outside cli/ prints or ends the program. Comments and strings are left out of the search.
# shellcheck disable=SC2086
for file in $library; do
    ${CC:-cc} -fpreprocessed -dD -E -P -x c "$file" 2>/dev/null | sed -E 's/"([^"\\]|\\.)*"//g' |
        grep -nE '(^|[^A-Za-z0-9_])(printf|vprintf|puts|putchar|perror|abort|exit|_exit|quick_exit|assert)[ ]*\(|(^|[^A-Za-z0-9_])(stdout|stderr)([^A-Za-z0-9_]|$)' | sed "s|^|$file: |"
done >"$work/log"
check "nothing outside cli prints or exits"

# Backends are named by tensor/ alone.
# shellcheck disable=SC2086
grep -nE '#[ \t]*include[ \t]*[<"](dnnl|cuda|nvrtc|cublas|cudnn)' $(echo "$library" | grep -v '^tensor/') >"$work/log"
check "backends are known to tensor only"

# Every energy is compared with an independent reference.
# shellcheck disable=SC2086
names=$(awk '/^HG_ENERGY\(/ { line = $0; if (line ~ /\($/) { getline more; line = line more }
    sub(/^HG_ENERGY\( */, "", line); sub(/[^a-z_0-9].*/, "", line); print line }' hairloss/*.c)
for name in $names; do
    grep -rqw "$name" tests/reference 2>/dev/null || echo "hairloss: $name is not in tests/reference"
    [ -f "hairloss/$name.c" ] || echo "hairloss: $name is not in a file of its name"
done >"$work/log"
check "every energy has a reference"

# Every reader is fuzzed.
# shellcheck disable=SC2086
for file in scene/read_*.c; do
    name=$(basename "$file" .c); name=${name#read_}
    ls tests/fuzz/fuzz_*.c | grep -q "$name" || grep -qw "$name" tests/fuzz/fuzz_*.c || echo "$file has no fuzz target in tests/fuzz"
done >"$work/log"
check "every reader has a fuzz target"

# shellcheck disable=SC2086
grep -E '\.(c|h|inc|py|sh|md|yaml|build)$|^run$' "$work/there" | grep -v '^LICENSE' | while read -r file; do
    lines=$(wc -l <"$file")
    if [ "$lines" -gt 900 ]; then echo "$file: $lines lines, a file has at most about 800"; fi
done >"$work/log"
check "no file is too long"

# shellcheck disable=SC2086
awk 'length($0) > 180 && FILENAME !~ /(^|\/)(base|tensor|autograd|trace|geometry|hairloss|scene|models|train|solvers|tasks|export|cli)\.h$/ { print FILENAME ":" FNR ": " length($0) " columns" }' $code >"$work/log"
check "no line is too long"

# shellcheck disable=SC2086
for file in $code; do
    first=$(sed -n '1{p;q;}' "$file")
    case "$first" in '/*'* | '//'*) ;; *) echo "$file does not begin with a comment that says what it is" ;; esac
done >"$work/log"
check "every file says what it is"

grep -vE '^(tests/test_house.sh|\.ci/)' "$work/there" | tr '\n' '\0' | xargs -0 grep -nIE '(^|[^A-Za-z0-9._-])/(work|home|root|Users|mnt|tmp/h)(/|[^A-Za-z0-9_]|$)' >"$work/log"
check "no paths of a machine"

headers=$(for folder in base tensor geometry autograd hairloss models scene train solvers tasks export; do [ -f $folder/$folder.h ] && echo $folder/$folder.h; done)
headers="$headers autograd/trace/trace.h hairgrad.h"
for header in $headers cli/cli.h; do ${CC:-cc} -std=gnu11 -Wall -Wextra -Wpedantic -fsyntax-only -I. -x c "$header" 2>&1 | grep -v 'pragma once in main file'; done >"$work/log"
check "public headers stand alone"
if command -v c++ >/dev/null 2>&1; then
    for header in $headers; do c++ -std=c++14 -fsyntax-only -I. -x c++ "$header" 2>&1; done >"$work/log"
    check "public headers are C++ too"
else
    echo "skip public headers are C++ too (no c++)"
fi
for header in $headers; do
    [ "$header" = hairgrad.h ] || grep -q "\"$header\"" hairgrad.h || grep -rq "\"$header\"" $headers || echo "hairgrad.h does not include $header"
done >"$work/log"
check "hairgrad.h includes every public header"
exit $failed
