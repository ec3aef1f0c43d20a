#!/bin/sh
# hairgrad gradcheck and hairgrad losses, as a user sees them. $1 is the build folder.
build=$(cd "$1" && pwd) || exit 1
hairgrad="$build/hairgrad" failed=0
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
export LD_LIBRARY_PATH="$build${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}" HAIRGRAD_CACHE="$work/cache" ASAN_OPTIONS="${ASAN_OPTIONS:+$ASAN_OPTIONS:}verify_asan_link_order=0"
cd "$work" || exit 1

ok() { echo "ok $1"; }
wrong() { echo "not ok $1"; sed 's/^/    /' log; failed=1; }
says() { # LABEL PATTERN COMMAND...: succeeds, and prints a line like that
    label=$1 pattern=$2; shift 2
    if "$@" >log 2>&1 && grep -Eq -- "$pattern" log; then ok "$label"; else wrong "$label"; fi
}
refuses() { # LABEL PATTERN COMMAND...: fails, with a line like that
    label=$1 pattern=$2; shift 2
    if "$@" >log 2>&1; then wrong "$label"; elif grep -Eq -- "$pattern" log; then ok "$label"; else wrong "$label"; fi
}

# Everything, and each input by name.
says "all ops and energies" '^[0-9]+ right, 0 wrong' "$hairgrad" gradcheck
[ "$(grep -c '^energy ' log)" -ge 30 ] && [ "$(grep -c '^op ' log)" -ge 30 ] && ok "they are many" || wrong "they are many"
for input in 'energy cosserat_bend_twist' 'energy integrity curve=softening' 'energy hair_style surface=scalp'; do
    grep -q "^$input" log && ok "$input" || wrong "$input"
done
# the root position of a direction, and nothing else
[ "$(awk '/^energy / { energy = $2 } /no effect/ { printf "%s.%s ", energy, $2 }' log)" = "shear.root_position " ] && ok "everything has an effect" || wrong "everything has an effect"
says "place of the worst" 'ok +x +[0-9.e-]+ +step 1e-[0-9]+ +worst at x: frame [01], strand [0-5], vertex [0-6], [xyz]' "$hairgrad" gradcheck stretch
says "only one input" '^1 right, 0 wrong' "$hairgrad" gradcheck stretch --wrt rest
says "one choice" '^2 right, 0 wrong' "$hairgrad" gradcheck bend_twist --set strain=smooth --set root=free --wrt x,stiffness
says "the sweep" 'step 1e-05 +numeric +-?[0-9.e-]+ +error [0-9.e-]+ +best' "$hairgrad" gradcheck stretch --wrt x --verbose
refuses "an input that is none" '--wrt ghost: none of these' "$hairgrad" gradcheck stretch --wrt ghost
refuses "a choice that is none" '--set strain=smoth: none of these' "$hairgrad" gradcheck bend_twist --set strain=smoth
refuses "an option without a choice" 'expected option=choice' "$hairgrad" gradcheck bend_twist --set strain
refuses "an op with --wrt" 'matmul is an op' "$hairgrad" gradcheck matmul --wrt x

# A user's own energy: half of one gradient is cut off, another is cut off entirely.
cat >own.c <<'END'
#include "hairloss/hairloss.h"
#include "autograd/trace/names.h"
static scalar half(void) { scalar l = norm(sub(x(1), x(0))); return mul(param("k"), l, detach(l)); }
HG_ENERGY(half, .equation = "k l^2", .source = "test", .site = window(2), .params = { { "k", 1, "N/m", "spring" } });
static scalar forgotten(void) { return mul(detach(param("k")), square(x(0))); }
HG_ENERGY(forgotten, .equation = "k x^2", .source = "test", .site = window(1), .params = { { "k", 1, "N/m", "spring" } });
static scalar still(void) { return square(detach(x(0))); }
HG_ENERGY(still, .equation = "[x]^2", .source = "test", .site = window(1));
END
# shellcheck disable=SC2046
if ${HAIRGRAD_TEST_CC:-cc} -shared -fPIC $("$hairgrad" flags) own.c -o own.so >log 2>&1; then ok "a plug-in"; else wrong "a plug-in"; exit 1; fi
refuses "half a gradient" 'WRONG x +x: frame [01], strand [0-5], vertex [0-6], [xyz]: analytic' "$hairgrad" --plugin ./own.so gradcheck half
grep -q '^1 right, 1 wrong' log && ok "and the right one beside it" || wrong "and the right one beside it"
refuses "a gradient of zeros" 'WRONG k +forgotten.k: frame [01], strand [0-5]: analytic 0, numeric' "$hairgrad" --plugin ./own.so gradcheck forgotten
refuses "no gradient in x" 'WRONG x +the gradient in x is zero everywhere' "$hairgrad" --plugin ./own.so gradcheck still

says "table" '^bend_twist_chain +scan 3 +stiffness = 1e-08 N\*m\^2; strain: published\|smooth; root: free\|clamped' "$hairgrad" losses
grep -q 'reads x, posed, body_distance (surface=body), scalp_distance (surface=scalp)' log && ok "what they read" || wrong "what they read"
says "one in full" 'ghost +\[B,S,V,3\] +differentiable' "$hairgrad" losses integrity
says "JSON" '"site_kind":[[:space:]]*"pairs"' "$hairgrad" losses --json
if command -v python3 >/dev/null 2>&1; then
    "$hairgrad" losses --json >all.json
    if python3 - >log 2>&1 <<'END'
import json
energies = {e["name"]: e for e in json.load(open("all.json"))}
assert len(energies) >= 20
for e in energies.values():
    assert e["equation"] and e["source"] and e["inputs"], e
    assert all(p["unit"] and p["help"] for p in e["parameters"]), e
assert [i["name"] for i in energies["inertia"]["inputs"]] == ["x", "predicted", "mass", "dt"]
assert energies["bend_twist_chain"]["site_kind"] == "scan"
END
    then ok "JSON holds every field"; else wrong "JSON holds every field"; fi
fi
exit $failed
