#!/bin/sh
# The examples that stand in the public headers' first comment compile, and run where they can (tests/examples/NAME.c is
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
