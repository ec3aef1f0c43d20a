#!/bin/sh
# make, info, pose and import's errors: what they write, what they say, and that a failure leaves files alone.
# Usage: test_scene_commands.sh BUILD
set -eu
hairgrad=$1/hairgrad
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"

fail() { echo "FAILED: $*" >&2; exit 1; }

# It must end with 1 (2: the command line itself) and one sentence that has $2 in it, and create nothing.
refuses() {
    code=$1; text=$2; shift 2
    set +e
    "$@" > out 2> err
    got=$?
    set -e
    rm -f out
    [ "$got" = "$code" ] || fail "$*: ended with $got, expected $code: $(cat err)"
    grep -qF -- "$text" err || fail "$*: \"$text\" is not in: $(cat err)"
    [ "$(grep -c . err)" = 1 ] || fail "$*: more than one sentence: $(cat err)"
    rm -f err
}

"$hairgrad" make bust -o bust.h5 > /dev/null
"$hairgrad" make groom --body bust.h5 --style curly --strands 120 --vertices 12 --seed 4 -o groom.h5 > /dev/null
"$hairgrad" make motion --body bust.h5 --kind shake --seconds 1 --rate 24 --seed 2 -o motion.h5 > /dev/null
"$hairgrad" pose --body bust.h5 --groom groom.h5 --motion motion.h5 --first 3 --frames 5 --shape head_width=0.5,0,-0.2 \
    --shape stature=-0.5 -o posed.h5 > /dev/null

"$hairgrad" info groom.h5 | grep -Eq '^  strands +120$' || fail "info: strands"
"$hairgrad" info bust.h5 | grep -q 'Neck1' || fail "info: joints"
"$hairgrad" info motion.h5 | grep -Eq '^  frames +25$' || fail "info: frames"
"$hairgrad" info posed.h5 | grep -Eq '^  strands +5 120 12 3$' || fail "info: posed strands"
"$hairgrad" info --json bust.h5 groom.h5 motion.h5 posed.h5 > info.json
if command -v python3 > /dev/null; then
    python3 - <<'PYTHON' || fail "info --json"
import json
bust, groom, motion, posed = json.load(open("info.json"))
assert groom["body_hash"] == bust["hash"] == posed["body_hash"] and posed["groom_hash"] == groom["hash"]
assert groom["strands"] == 120 and groom["bound_roots"] == 120 and groom["shortest"] > 0.1
assert 60 < groom["strands_in_64x64_texture"] <= 120
assert motion["joint_names"] == bust["joint_names"] and motion["seconds"] == 1
assert posed["body_vertices"] == [5, bust["vertices"], 3] and posed["first_frame"] == 3
PYTHON
fi

# the same seed is the same file, another one another
"$hairgrad" make groom --body bust.h5 --style curly --strands 120 --vertices 12 --seed 4 --threads 1 -o again.h5 > /dev/null
cmp -s groom.h5 again.h5 || fail "make groom: not the same file again"
"$hairgrad" make groom --body bust.h5 --style curly --strands 120 --vertices 12 --seed 5 -o again.h5 > /dev/null
cmp -s groom.h5 again.h5 && fail "make groom: the seed changes nothing"

refuses 1 'did you mean curly?' "$hairgrad" make groom --style curley -o bad.h5
refuses 1 '0 strands' "$hairgrad" make groom --strands 0 -o bad.h5
refuses 1 'bust, groom or motion' "$hairgrad" make wig -o bad.h5
refuses 1 'needs --output' "$hairgrad" make bust
refuses 1 'did you mean head_width?' "$hairgrad" pose --body bust.h5 --motion motion.h5 --shape head_widht=1 -o bad.h5
refuses 1 'frames 20 to 29 of a motion of 25' "$hairgrad" pose --body bust.h5 --motion motion.h5 --first 20 --frames 10 -o bad.h5
refuses 1 'it is a hairgrad groom, expected a hairgrad body' "$hairgrad" pose --body groom.h5 --motion motion.h5 -o bad.h5
refuses 1 'nothing.h5' "$hairgrad" pose --body bust.h5 --motion nothing.h5 -o bad.h5
refuses 1 'pose needs --body' "$hairgrad" pose -o bad.h5
refuses 1 'nothing.h5' "$hairgrad" info nothing.h5
refuses 2 'did you mean "--json"' "$hairgrad" info --jsno groom.h5
head -c 3000 groom.h5 > cut.h5
refuses 1 'cut.h5' "$hairgrad" info cut.h5
[ ! -e bad.h5 ] || fail "a failure wrote a file"

# the bust is the same everywhere, and a failure leaves files alone
"$hairgrad" make bust -o twin.h5 > /dev/null
cmp -s bust.h5 twin.h5 || fail "make bust: not the same file again"
cp groom.h5 kept.h5
refuses 1 'nowhere' "$hairgrad" make groom --strands 10 -o /nowhere/at/all.h5
refuses 1 'did you mean curly?' "$hairgrad" make groom --style curley -o groom.h5
cmp -s groom.h5 kept.h5 || fail "a failure changed an existing file"
echo "make, info and pose: as expected"
