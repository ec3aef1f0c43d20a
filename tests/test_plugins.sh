#!/bin/sh
# Plug-ins as a user has them: built by cc, given before or after the command or in HAIRGRAD_PLUGINS; and what is said of
# those that are wrong, each in one sentence with the file. $1 is the build folder.
build=$1 source=${HG_SOURCE:-$(dirname "$0")/..} failed=0
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
export LD_LIBRARY_PATH="$build${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}" HAIRGRAD_CACHE="$work/cache" ASAN_OPTIONS="${ASAN_OPTIONS:+$ASAN_OPTIONS:}verify_asan_link_order=0"
hairgrad=$build/hairgrad

ok() { echo "ok $1"; }
wrong() { echo "not ok $1"; sed 's/^/    /' "$work/log"; failed=1; }

# NAME, the C text on stdin. The flags are those that the program says.
plugin() {
    { echo '#include "hairloss/hairloss.h"'; echo '#include "autograd/trace/names.h"'; cat; } >"$work/$1.c"
    # shellcheck disable=SC2046
    ${HAIRGRAD_TEST_CC:-cc} -shared -fPIC $("$hairgrad" flags) "$work/$1.c" -o "$work/$1.so" >"$work/log" 2>&1 || { wrong "$1 builds"; exit 1; }
}
works() { # LABEL WORD COMMAND...: ends well and says WORD
    label=$1 word=$2; shift 2
    if (cd "$work" && "$@") >"$work/log" 2>&1 && grep -q -- "$word" "$work/log"; then ok "$label"; else wrong "$label"; fi
}
refused() { # LABEL WORDS COMMAND...: fails with one line on stderr that has WORDS
    label=$1 words=$2; shift 2
    (cd "$work" && "$@") >"$work/out" 2>"$work/log"; status=$?
    if [ $status = 1 ] && [ "$(wc -l <"$work/log")" = 1 ] && grep -q -- "$words" "$work/log"; then ok "$label"; else echo "exit status $status" >>"$work/log"; wrong "$label"; fi
}
bad() { plugin "$1"; refused "$1" "$1.so: .*$2" "$hairgrad" --plugin "$1.so" losses; }

# ---- good ones ---------------------------------------------------------------------------------------------------

plugin tip_rise <<'END'
static scalar tip_rise(void)
{
    scalar rise = sub(x(0).y, root_x(0).y);
    return mul(0.5, param("stiffness"), square(max(rise, 0)));
}
HG_ENERGY(tip_rise, .equation = "k/2 max(y - y_root, 0)^2", .source = "test", .site = window(1),
          .params = { { "stiffness", 0.1, "N/m", "how strongly" } });
END
plugin squares <<'END'
static hg_tensor *shape(hg_call *call) { return hg_tensor_make(call->ctx, call->in[0]->dtype, call->in[0]->rank, call->in[0]->shape); }
static hg_status forward(hg_call *call)
{
    for (int64_t i = 0; i < hg_tensor_count(call->out); i++)
        if (call->out->dtype == HG_F64) ((double *)call->out->data)[i] = ((double *)call->in[0]->data)[i] * ((double *)call->in[0]->data)[i];
        else ((float *)call->out->data)[i] = ((float *)call->in[0]->data)[i] * ((float *)call->in[0]->data)[i];
    return HG_OK;
}
static hg_status backward(hg_call *call)
{
    for (int64_t i = 0; i < hg_tensor_count(call->out); i++)
        if (call->out->dtype == HG_F64) ((double *)hg_grad(call->in[0])->data)[i] += 2 * ((double *)call->in[0]->data)[i] * ((double *)hg_grad(call->out)->data)[i];
        else ((float *)hg_grad(call->in[0])->data)[i] += 2 * ((float *)call->in[0]->data)[i] * ((float *)hg_grad(call->out)->data)[i];
    return HG_OK;
}
static const hg_sample samples[] = { { "five", 1, { { 1, { 5 } } } } };
HG_OP(squares, .formula = "y = x x", .min_in = 1, .max_in = 1, .shape = shape, .forward = forward, .backward = backward, .samples = samples, .n_samples = 1);
END

plugin twigs <<'END'
#include "scene/scene.h"
static hg_status read_twigs(hg_curves **curves, const char *path)
{
    (void)path;
    HG_TRY(hg_curves_create(curves, 2, 4));
    for (int i = 0; i < 3; i++) (*curves)->start[i] = 2 * i;
    for (int i = 0; i < 4; i++) (*curves)->points[3 * i + 1] = (float)(0.1 * (i % 2) + 0.01 * i);
    return HG_OK;
}
static const hg_groom_reader reader = { .extension = "twigs", .what = "twigs", .read = read_twigs, .metres = true };
HG_REGISTER("groom reader", twigs, &reader);
END
echo anything >"$work/two.twigs"

works "before the command" "max(y - y_root" "$hairgrad" --plugin tip_rise.so losses tip_rise
works "after the command" "max(y - y_root" "$hairgrad" losses tip_rise --plugin tip_rise.so
works "between, joined" "max(y - y_root" "$hairgrad" losses --plugin=tip_rise.so tip_rise
works "in HAIRGRAD_PLUGINS" "max(y - y_root" env "HAIRGRAD_PLUGINS=:$work/squares.so:$work/tip_rise.so:" "$hairgrad" losses tip_rise
works "the same file twice" "max(y - y_root" env "HAIRGRAD_PLUGINS=$work/tip_rise.so" "$hairgrad" --plugin tip_rise.so losses tip_rise --plugin ./tip_rise.so
works "gradcheck of an energy" "tip_rise" "$hairgrad" gradcheck tip_rise --plugin tip_rise.so
works "gradcheck of an op" "squares" "$hairgrad" --plugin squares.so gradcheck squares
works "both at once" "squares" "$hairgrad" --plugin squares.so gradcheck squares tip_rise --plugin tip_rise.so
works "a reader of one's own" "2 strands" "$hairgrad" convert two.twigs two.ply --plugin twigs.so
refused "without it" "no reader for strands" "$hairgrad" convert two.twigs two.ply
cat >"$work/own.yaml" <<'END'
scene: { style: straight, strands: 60, vertices: 8, seconds: 1 s, motion_kinds: [nod], held_out_kinds: [nod] }
model: { width: 16, pinned: 2 }
features: { history: 2, encoder_width: 16, encoder_steps: 2 }
losses: { stretch: {}, tip_rise: { stiffness: 0.2 N/m } }
training: { strands: 30, frames: 1, steps: 2, validate_every: 2, checkpoint_every: 2 }
END
works "train" "trained 2 steps" "$hairgrad" train own.yaml -o run --plugin tip_rise.so
works "evaluate" "tip_rise" "$hairgrad" evaluate run --plugin tip_rise.so --frames 3
refused "evaluate without it names what is missing" 'losses.tip_rise".*plug-in' "$hairgrad" evaluate run
refused "train without it" 'losses.tip_rise".*plug-in' "$hairgrad" train own.yaml -o run2
sed 's/, tip_rise: { stiffness: 0.2 N.m }//' "$work/own.yaml" >"$work/without.yaml"
works "train without using it" "trained 2 steps" "$hairgrad" train without.yaml -o run3 --plugin tip_rise.so
works "the run does not need it" "stretch" "$hairgrad" evaluate run3

# ---- wrong ones --------------------------------------------------------------------------------------------------

refused "no file" "nowhere.so: " "$hairgrad" --plugin nowhere.so losses
echo text >"$work/text.so"
refused "no shared object" "text.so: .*cannot be loaded" "$hairgrad" losses --plugin text.so
refused "in HAIRGRAD_PLUGINS" "text.so: .*cannot be loaded" env HAIRGRAD_PLUGINS=text.so "$hairgrad" losses
(cd "$work" && "$hairgrad" losses --plugin) >"$work/log" 2>&1; [ $? = 2 ] && ok "no FILE" || wrong "no FILE"

formula='static scalar one(void) { return x(0).y; }'
bad empty "registers nothing" <<'END'
int nothing;
END
bad missing "undefined_function" <<'END'
scalar undefined_function(void);
static scalar missing(void) { return undefined_function(); }
HG_ENERGY(missing, .site = window(1));
END
bad taken 'energy "stretch".*taken' <<END
static scalar stretch(void) { return x(0).y; }
HG_ENERGY(stretch, .site = window(1));
END
bad no_formula "energy 'no_formula' has no formula" <<'END'
static const hg_energy e = { .name = "no_formula", .site = window(1) };
HG_REGISTER("energy", no_formula, &e);
END
bad window_0 "energy 'one': a window of 0 vertices" <<END
$formula
HG_ENERGY(one, .equation = "y");
END
bad window_9 "energy 'one': a window of 9 vertices" <<END
$formula
HG_ENERGY(one, .site = window(9));
END
bad no_unit "parameter 'k' has no unit" <<END
$formula
HG_ENERGY(one, .site = window(1), .params = { { "k", 1 } });
END
bad no_param_name "parameter number 1 has no name" <<END
$formula
HG_ENERGY(one, .site = window(1), .params = { { NULL, 1, "N" } });
END
bad not_a_number "default of parameter 'k' is not a number" <<END
$formula
HG_ENERGY(one, .site = window(1), .params = { { "k", 0.0 / 0.0, "N" } });
END
bad twice "parameter 'k' is declared twice" <<END
$formula
HG_ENERGY(one, .site = window(1), .params = { { "k", 1, "N" }, { "k", 1, "N" } });
END
bad undeclared "energy 'one' asks for param 'stifness'.*did it mean 'stiffness'" <<'END'
static scalar one(void) { return mul(param("stifness"), x(0).y); }
HG_ENERGY(one, .site = window(1), .params = { { "stiffness", 1, "N" } });
END
bad outside "energy 'one' asks for x(2), but its site has 2 vertices" <<'END'
static scalar one(void) { return x(2).y; }
HG_ENERGY(one, .site = window(2));
END
bad other_choice "asks for param 'b'" <<'END'
static scalar one(void) { return option("kind", "second") ? mul(param("b"), x(0).y) : x(0).y; }
HG_ENERGY(one, .site = window(1), .options = { { "kind", "first|second", "first", "" } });
END
bad no_choice "default \"third\" of option 'kind'" <<'END'
static scalar one(void) { return x(0).y; }
HG_ENERGY(one, .site = window(1), .options = { { "kind", "first|second", "third", "" } });
END
bad contact "does not declare it: .contact = true" <<'END'
static scalar one(void) { return contact_distance(0); }
HG_ENERGY(one, .site = window(1));
END
bad spaces "'two words' is no name" <<'END'
static scalar one(void) { return x(0).y; }
static const hg_energy e = { .name = "two words", .trace = one, .site = window(1) };
HG_REGISTER("energy", two, &e);
END
bad other_name "registered under another name" <<'END'
static scalar one(void) { return x(0).y; }
static const hg_energy e = { .name = "one", .trace = one, .site = window(1) };
HG_REGISTER("energy", two, &e);
END
bad older "ABI version 0" <<'END'
static scalar one(void) { return x(0).y; }
static const hg_energy e = { .name = "one", .trace = one, .site = window(1) };
__attribute__((constructor)) static void register_one(void)
{
    static hg_entry entry = { .abi = 0, .kind = "energy", .name = "one", .item = &e };
    hg_register(&entry);
}
END
bad ancient "an old one" <<'END'
static struct { const char *kind, *name; const void *item; void *next; } entry = { "energy", "one", 0, 0 };
__attribute__((constructor)) static void register_one(void) { hg_register((hg_entry *)(void *)&entry); }
END
bad no_backward "op 'flat' has no backward" <<'END'
static hg_tensor *shape(hg_call *call) { return call->in[0]; }
static hg_status forward(hg_call *call) { (void)call; return HG_OK; }
HG_OP(flat, .formula = "", .min_in = 1, .max_in = 1, .shape = shape, .forward = forward);
END
bad no_create "model 'mine' has no create" <<'END'
#include "models/models.h"
static const hg_architecture mine = { .name = "mine", .what = "nothing" };
HG_REGISTER("model", mine, &mine);
END
exit $failed
