#!/bin/sh
# hairgrad convert and hairgrad check, through the program. $1 is the build folder.
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
same() { # NAME A B
    if cmp "$2" "$3" >err 2>&1; then echo "ok $1"; else echo "not ok $1"; sed 's/^/    /' err; failed=1; fi
}
gone() { if [ -e "$2" ]; then echo "not ok $1: $2 is there"; failed=1; else echo "ok $1"; fi; }

"$program" make bust -o bust.h5 >/dev/null && "$program" make groom --body bust.h5 --strands 60 --vertices 16 -o groom.h5 >/dev/null || exit 1
"$program" make motion --body bust.h5 --kind nod --seconds 0.2 -o motion.h5 >/dev/null || exit 1
"$program" pose --body bust.h5 --groom groom.h5 --motion motion.h5 -o posed.h5 >/dev/null || exit 1

# ---- convert: round a circle of all formats, back to the same bytes
says "groom to .hair" 0 'a.hair: 60 strands, 960 vertices, in m, \+Y up' "$program" convert groom.h5 a.hair
for step in "a.hair b.data" "b.data c.bin" "c.bin d.ply" "d.ply e.npz" "e.npz f.tfx" "f.tfx g.ply --variant ascii" "g.ply h.vtkhdf" "h.vtkhdf i.npy" "i.npy j.hair" "j.hair k.obj"; do
    # shellcheck disable=SC2086
    says "convert $step" 0 '60 strands, 960 vertices, in m' "$program" convert $step
done
same "all the way round" a.hair j.hair
says "an assumed unit is said" 0 'metres, \+Y up are assumed; a .hair file does not say' "$program" convert a.hair x.data
says "centimetres are noticed" 0 'it looks like cm \(--unit cm\)' sh -c "'$program' convert a.hair cm.hair --out-unit cm && '$program' convert cm.hair y.hair --force"
says "centimetres are read" 0 '60 strands' "$program" convert cm.hair y.hair --unit cm --force
says "up and unit" 0 'in cm, \+Z up' "$program" convert a.hair z.hair --out-up z --out-unit cm
says "and back" 0 'in m, \+Y up' "$program" convert z.hair z2.hair --up z --unit cm
says "fewer strands" 0 'w.data: 20 strands, 320 vertices' "$program" convert a.hair w.data --every 3
says "so many strands" 0 'w.data: 7 strands, 49 vertices' "$program" convert a.hair w.data --strands 7 --vertices 7 --force
says "a frame" 0 'p.hair: 60 strands' "$program" convert posed.h5 p.hair --frame 3
says "strands as a drape of one frame" 0 'pixels' "$program" render h.vtkhdf --size 60x70 -o h.png
says "a groom stays bound" 0 '20 strands' "$program" convert groom.h5 third.h5 --every 3
says "as info says" 0 'bound_roots +20' "$program" info third.h5

before=$(cksum <w.data)
says "no writing over" 1 'w.data: is there already; --force' "$program" convert a.hair w.data
says "not with an error either" 1 'there are 60' "$program" convert a.hair w.data --strands 61 --force
[ "$before" = "$(cksum <w.data)" ] && echo "ok it is untouched" || { echo "not ok it is untouched"; failed=1; }
says "a frame that is not there" 1 'posed.h5: frame 99: it has frames 0 to' "$program" convert posed.h5 n.hair --frame 99
says "an unknown reader" 1 'no reader for strands in a file ending in ".xyz"' "$program" convert a.xyz n.hair
says "an unknown writer" 1 'no writer for strands to a file ending in ".xyz"; known are .*\.tfx' "$program" convert a.hair n.xyz
says "an unknown variant" 1 'no variant "5"; known are 4\|3' "$program" convert a.hair n.tfx --variant 5
says "an unknown unit" 1 'unit' "$program" convert a.hair n.tfx --unit parsec
says "a unit where there is one" 1 'have their own unit' "$program" convert groom.h5 n.tfx --unit cm
says "both ways to choose" 1 'one of them' "$program" convert a.hair n.tfx --every 2 --strands 3
says "a missing file" 1 'missing.ply: cannot be opened' "$program" convert missing.ply n.tfx
gone "nothing is written then" n.tfx; gone "nor this" n.hair
printf 'ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement edge 2\nproperty int vertex1\nproperty int vertex2\nend_header\n0 0 0\n0 0.1 0\n0 0.3 0\n1 0 0\n0 1\n1 2\n' >bald.ply
says "bald strands are told" 0 'bald.ply: 2 strands, 4 vertices, 1 dropped: bald' "$program" convert bald.ply bald.data
says "or kept" 0 'kept.data: 2 strands, 4 vertices' "$program" convert bald.ply kept.data --keep-bald
says "not where they cannot be" 1 'strand 0 has 3 vertices and strand 1 has 1; .tfx' "$program" convert bald.ply n.tfx --keep-bald

# ---- check
says "a good groom" 0 '^ok +roots' "$program" check groom.h5 --body bust.h5 --image groom.png
[ -s groom.png ] && echo "ok its picture" || { echo "not ok its picture"; failed=1; }
says "a good body" 0 '^ok +joints' "$program" check bust.h5
says "a good motion" 0 '^ok +joints' "$program" check motion.h5 --body bust.h5
says "a frame" 0 '^ok +strands +60' "$program" check posed.h5 --frame 2
says "an odd unit" 0 '^warning +unit .*looks like cm' "$program" check cm.hair
says "odd axes" 0 '^warning +up .*--up z' "$program" check z.hair --unit cm
says "axes given" 0 '^ok +up' "$program" check z.hair --unit cm --up z
says "far from the body" 0 '^warning +roots .*import groom --find' "$program" check cm.hair --body bust.h5
find . -type f | LC_ALL=C sort >before.list; touch after.list; find . -type f | LC_ALL=C sort >before.list
says "a recipe" 0 '^ok +memory' "$program" check "$source/examples/recipes/quasi_static.yaml"
find . -type f | LC_ALL=C sort >after.list
same "a check writes nothing" before.list after.list
printf 'scene: {groom: none.h5}\nlosses: {gravity: {}}\n' >bad.yaml
says "a bad recipe" 1 '^error +file +line 1, scene.groom: none.h5: cannot be opened' "$program" check bad.yaml
says "a truncated file" 1 'cut.hair: .*are there' sh -c "head -c 500 a.hair >cut.hair; '$program' check cut.hair"
says "a file of no kind" 1 'x.bvh: strands .* a body or a motion \(.h5, once imported\)' "$program" check x.bvh
says "as JSON" 1 '"severity": "error"' sh -c "'$program' check cut.hair --json >cut.json; status=\$?; cat cut.json; exit \$status"
if command -v python3 >/dev/null 2>&1; then says "that can be parsed" 0 'cut.hair 1' python3 -c "import json; f = json.load(open('cut.json')); print(f['file'], f['errors'])"; fi
"$program" check groom.h5 --json >groom.json
if command -v python3 >/dev/null 2>&1; then says "no errors as JSON" 0 '^0 0$' python3 -c "import json; f = json.load(open('groom.json')); print(f['errors'], f['warnings'])"; fi
exit $failed
