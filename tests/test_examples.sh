#!/bin/sh
# examples/*.c and examples/failures/*.c compile, run, and print what stands in the .txt beside them, numbers to 2 % or two
# units of the last place. The examples that stand in the public headers' first comment compile, and run where they can (tests/examples/NAME.c is
# the program around one); so do the C examples of README.md and docs/. $1 is the build folder.
build=$1 source=${HG_SOURCE:-$(dirname "$0")/..} failed=0
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
export LD_LIBRARY_PATH="$build${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}"
flags="-std=gnu11 -g -Wall -Wextra -Wno-unused-variable -Wno-unused-function -I$work -I$source"
if grep -q 'fsanitize=address' "$build/compile_commands.json" 2>/dev/null; then flags="$flags -fsanitize=address,undefined"; fi
link="-L$build -lhairgrad -lm"

ok() { echo "ok $1"; }
wrong() { echo "not ok $1"; sed 's/^/    /' "$work/log"; failed=1; }

# What stands after a gap behind a statement is a remark, "..." is left out.
extract() { awk '/^#ifndef/ { exit } /^ \*     / { print substr($0, 8) }' "$1" | grep -v '^ *\.\.\.$' | sed -E 's/([;)])  +[^ ;].*$/\1/; s/\{ \.\.\. /{ /'; }

# Two texts are the same but for the numbers' last places. Says what differs.
same() { # EXPECTED GOT
    awk '
        function places(n,   at) { at = index(n, "."); return n ~ /[eE]/ || !at ? 0 : length(n) - at }
        function near(a, b,   d, m) {
            if (a == b) return 1
            if (!places(a) && a !~ /[eE]/) return 0
            d = a - b; if (d < 0) d = -d
            m = (a < 0 ? -a : a + 0); if ((b < 0 ? -b : b + 0) > m) m = (b < 0 ? -b : b + 0)
            return d <= 0.02 * m || (places(a) && d <= 2 * 10 ^ -places(a) * 1.0001)
        }
        function split_line(line, numbers, texts,   n) {
            n = 0
            while (match(line, /[-+]?[0-9]+(\.[0-9]+)?([eE][-+]?[0-9]+)?/)) {
                texts[n] = substr(line, 1, RSTART - 1); gsub(/ +/, " ", texts[n])
                numbers[n++] = substr(line, RSTART, RLENGTH); line = substr(line, RSTART + RLENGTH)
            }
            texts[n] = line
            return n
        }
        NR == FNR { expected[++lines] = $0; next }
        {
            got++
            n = split_line(expected[FNR], en, et); m = split_line($0, gn, gt); bad = n != m
            for (i = 0; i <= n && !bad; i++) if (et[i] != gt[i] || (i < n && !near(en[i], gn[i]))) bad = 1
            if (bad) { print "expected: " expected[FNR]; print "got:      " $0; wrong = 1 }
        }
        END { if (got != lines) { print got + 0 " lines, expected " lines; wrong = 1 } exit wrong }
    ' "$1" "$2"
}

for program in "$source"/examples/*.c "$source"/examples/failures/*.c; do
    name=${program#"$source/"} expected=${program%.c}.txt
    # shellcheck disable=SC2086
    if ! ${CC:-cc} $flags "$program" -o "$work/program" $link >"$work/log" 2>&1; then wrong "$name"
    elif ! "$work/program" >"$work/printed" 2>"$work/log"; then wrong "$name: runs"
    elif ! same "$expected" "$work/printed" >"$work/log" 2>&1; then wrong "$name: prints what it should"
    elif [ "$(wc -l <"$program")" -ge 150 ]; then wrong "$name: 150 lines or more"
    else ok "$name"; fi
done

for program in "$source"/tests/examples/*.c; do
    name=$(basename "$program" .c)
    header=$(find "$source/$name" "$source/autograd/$name" -maxdepth 1 -name "$name.h" 2>/dev/null | head -n 1)
    extract "$header" >"$work/example.inc"
    if [ ! -s "$work/example.inc" ]; then echo "$header has no example" >"$work/log"; wrong "example of $name.h"; continue; fi
    mkdir -p "$work/$name"
    # shellcheck disable=SC2086
    if ${CC:-cc} $flags "$program" -o "$work/program" $link >"$work/log" 2>&1 && "$work/program" "$work/$name$([ "$name" = base ] && echo /file)" >>"$work/log" 2>&1; then ok "example of $name.h"
    else wrong "example of $name.h"; fi
done

# Every ```c block of a document: with main it is run; with HG_ENERGY it becomes a plug-in whose energy is checked.
for document in "$source"/README.md "$source"/docs/*.md; do
    [ -f "$document" ] || continue
    rm -f "$work"/block-*
    awk -v at="$work/block-" '/^```c$/ { n++; inside = 1; next } /^```/ { inside = 0 } inside { print > (at n ".c") }' "$document"
    for block in "$work"/block-*.c; do
        [ -f "$block" ] || continue
        label="$(basename "$document"), $(basename "$block" .c)"
        if grep -q 'main *(' "$block"; then
            # shellcheck disable=SC2086
            if ${CC:-cc} $flags "$block" -o "$work/program" $link >"$work/log" 2>&1 && (cd "$work" && ./program) >>"$work/log" 2>&1; then ok "$label"; else wrong "$label"; fi
        elif grep -q 'HG_ENERGY *(' "$block"; then
            energy=$(sed -n 's/.*HG_ENERGY *( *\([a-z_0-9]*\).*/\1/p' "$block" | head -n 1)
            # shellcheck disable=SC2086
            if ${CC:-cc} $flags -fPIC -shared "$block" -o "$work/plugin.so" $link >"$work/log" 2>&1 &&
               "$build/hairgrad" --plugin "$work/plugin.so" gradcheck "$energy" >>"$work/log" 2>&1; then ok "$label"; else wrong "$label"; fi
        else
            # shellcheck disable=SC2086
            if ${CC:-cc} $flags -fsyntax-only "$block" >"$work/log" 2>&1; then ok "$label"; else wrong "$label"; fi
        fi
    done
done
exit $failed
