#!/bin/sh
# hairgrad evaluate --against, through the program, on a small procedural run. $1 is the build folder.
build=$1 source=${HG_SOURCE:-$(cd "$(dirname "$0")/.." && pwd)} failed=0
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
export LD_LIBRARY_PATH="$build${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}" OMP_NUM_THREADS=2
program=$build/hairgrad
cd "$work" || exit 1

says() { # NAME STATUS PART COMMAND...: it ends with STATUS and says PART
    name=$1 expected=$2 part=$3; shift 3
    "$@" >out 2>err; status=$?
    if [ "$status" != "$expected" ]; then echo "not ok $name: status $status"; sed 's/^/    /' out err; failed=1
    elif ! grep -qE -e "$part" out err; then echo "not ok $name: no \"$part\""; sed 's/^/    /' out err; failed=1
    elif [ -n "$(find . -name '*.part-*')" ]; then echo "not ok $name: a temporary file is left"; failed=1
    else echo "ok $name"; fi
}
gone() { if [ -e "$2" ]; then echo "not ok $1: $2 is there"; failed=1; else echo "ok $1"; fi; }
# The i-th number of a key in the file, as the i-th number of a column in the table prints it.
equal() { # NAME KEY SCALE DECIMALS COLUMN PART: of the rows of PART ("rest" or "motion")
    sed -n '/"clips"/,/"mean"/p' result.json | awk -v key="\"$2\":" -v part="\"$6\":" -v scale="$3" -v d="$4" \
        '$1 == "\"rest\":" || $1 == "\"motion\":" { on = $1 == part } on && $1 == key { sub(",", "", $2); if ($2 == "null") print "-"; else printf "%.*f\n", d, $2 * scale }' >fromfile
    awk -v part="$6" -v column="$5" '/^at rest:/ { on = part == "rest" } /^in motion:/ { on = part == "motion" } /^$/ { on = 0 }
        on && $1 == "shake" && $2 == "1500" { shift = $3 == "posed" ? 1 : 0; print $(3 + shift + column) }' out.table >fromtable
    if [ -s fromfile ] && cmp -s fromfile fromtable; then echo "ok $1"; else echo "not ok $1"; paste fromfile fromtable | sed 's/^/    /'; failed=1; fi
}

sed -e 's/strands: 2000/strands: 120/' -e 's/vertices: 25/vertices: 12/' -e 's/seconds: 10 s/seconds: 1 s/' -e 's/strands: 512/strands: 40/' \
    -e 's/history: 10/history: 2/' -e 's/held_out_kinds: .*/held_out_kinds: [shake]/' -e 's/motion_kinds: \[nod.*/motion_kinds: [nod]/' \
    -e 's/encoder_steps: 300/encoder_steps: 20/' -e 's/steps: 6000/steps: 20/' -e 's/validate_every: 500/validate_every: 20/' \
    "$source/examples/recipes/demo.yaml" >recipe.yaml
"$program" train recipe.yaml -o run --device cpu >log 2>&1 || { cat log; exit 1; }

says "two solvers side by side" 0 '^xpbd: [0-9]+ of 120 strands came to rest' "$program" evaluate run --device cpu --against lbfgs --against xpbd --against-strands 20 --against-frames 12 --json result.json --plot plot.png
cp out out.table
says "a picture" 0 PNG head -c 8 plot.png
for side in network lbfgs xpbd 'posed groom'; do says "a row of $side" 0 "^shake 1500 +$side " cat out.table; done
says "the gap of the reference" 0 '^shake 1500 +lbfgs +[0-9.]+ +[0-9.]+ +[0-9.]+ +[0-9.]+ +[0-9.]+ +[-0-9.]+ +0.000 ' cat out.table
says "how many are there" 0 '^lbfgs, at rest: [0-9]+ of 120 strands at their minimum' cat out.table
says "terms beside each other" 0 '^bend_twist( +[0-9.]+){4}$' cat out.table
equal "the inside of the table is that of the file" inside_percent 1 3 2 rest
equal "its turns" orientation_degrees 1 2 4 rest
equal "its gaps" gap 1 3 7 rest
equal "its gaps in motion" gap 1 3 7 motion
equal "its tips" tip_excursion_of_reference 1 2 14 motion
if command -v python3 >/dev/null; then says "the file is JSON" 0 'posed groom' python3 -m json.tool result.json; fi
"$program" evaluate run --device cpu --against lbfgs --against xpbd --against-strands 20 --against-frames 12 --json again.json --threads 1 >/dev/null 2>&1
grep -v seconds_per_frame result.json >first; grep -v seconds_per_frame again.json >second
if cmp -s first second; then echo "ok the same with one thread"; else echo "not ok the same with one thread"; failed=1; fi

says "at rest alone" 0 '^sum' "$program" evaluate run --device cpu --against lbfgs --against-strands 10 --against-frames 2 --set losses.inertia.weight=0 --set losses.drag.weight=0
if grep -q 'in motion' out; then echo "not ok no motion without inertia"; failed=1; else echo "ok no motion without inertia"; fi
says "an unknown method" 1 'against newton: lbfgs, adam or xpbd' "$program" evaluate run --against newton
says "twice the same" 1 'given twice' "$program" evaluate run --against lbfgs --against lbfgs
says "frames that are none" 1 'whole number above 0' "$program" evaluate run --against lbfgs --against-frames none
says "a plot of nothing" 1 'goes with --against' "$program" evaluate run --plot no.png
gone "nothing is drawn then" no.png
says "help" 0 'against METHOD' "$program" evaluate --help
exit $failed
