#!/bin/sh
# `hairgrad trace`: a report for every energy, counts that only fall until the derivative is added, C that is the kernel's, and
# one sentence for what is wrong. $1 is the build folder.
build=$1 failed=0
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
export LD_LIBRARY_PATH="$build${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}"
hairgrad=$build/hairgrad

ok() { echo "ok $1"; }
wrong() { echo "not ok $1"; sed 's/^/    /' "$work/log"; failed=1; }
number() { sed -n "s/^    $1  *\([0-9][0-9]*\).*/\1/p" "$work/log" | head -n 1; }
refused() { label=$1 words=$2; shift 2; "$@" >/dev/null 2>"$work/log"; [ $? = 1 ] && [ "$(wc -l <"$work/log")" = 1 ] && grep -q -- "$words" "$work/log" && ok "$label" || wrong "$label"; }

for energy in $("$hairgrad" losses | grep -E '^[a-z_0-9]+$'); do
    if "$hairgrad" trace "$energy" >"$work/log" 2>&1 && [ "$(number 'asked for')" -gt 0 ] && [ "$(number 'after folding')" -le "$(number 'asked for')" ] &&
       [ "$(number 'after dropping the dead')" -le "$(number 'after sharing')" ] && [ "$(number 'with the derivative')" -ge "$(number 'after dropping the dead')" ]; then ok "$energy"
    else wrong "$energy"; fi
done

"$hairgrad" trace bend_twist >"$work/log" 2>&1; published=$(number 'with the derivative') at_site=$(number 'at every site') hoisted=$(number 'once per groom and site')
[ "$hoisted" -gt 20 ] && ok "rest data is hoisted" || wrong "rest data is hoisted"
"$hairgrad" trace bend_twist --wrt rest,bend_twist.stiffness >"$work/log" 2>&1
[ "$(number 'at every site')" -gt "$at_site" ] && [ "$(number 'once per groom and site')" -lt "$hoisted" ] && ok "what is differentiated is not hoisted" || wrong "what is differentiated is not hoisted"
"$hairgrad" trace bend_twist --set bend_twist.strain=smooth >"$work/log" 2>&1 && grep -q 'strain = smooth' "$work/log" && [ "$(number 'with the derivative')" != "$published" ] && ok "an option" || wrong "an option"
"$hairgrad" trace stretch gravity --c >"$work/log" 2>&1 && grep -q '^static void kernel' "$work/log" && grep -q 'energy\[1\] +=' "$work/log" && ok "C of a sum" || wrong "C of a sum"
"$hairgrad" trace stretch gravity --cuda >"$work/log" 2>&1 && grep -q '^extern "C" __global__ void' "$work/log" && grep -q 'kernel_cuda(' "$work/log" && ! grep -q atomic "$work/log" && ok "CUDA of a sum" || wrong "CUDA of a sum"
refused "no such energy" "did you mean 'stretch'" "$hairgrad" trace strech
refused "no such option" 'did you mean "strain"' "$hairgrad" trace bend_twist --set strian=smooth
refused "no such choice" "possible are published|smooth" "$hairgrad" trace bend_twist --set strain=rough
refused "nothing it depends on" "'colour' is nothing" "$hairgrad" trace stretch --wrt colour
refused "no C of pairs" "interpreted" "$hairgrad" trace adhesion --c
refused "pairs in a sum" "trace it alone" "$hairgrad" trace stretch adhesion
exit $failed
