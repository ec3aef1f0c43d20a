#!/bin/sh
# Installed into a folder, the headers, the library and the program are enough: a plug-in and programs in C and C++ are
# built with pkg-config and with `hairgrad flags`, and run. $1 is the build folder.
build=$1 failed=0
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
export HAIRGRAD_CACHE="$work/cache"
sanitized=
if grep -q 'fsanitize=address' "$build/compile_commands.json" 2>/dev/null; then sanitized=-fsanitize=address,undefined; fi

ok() { echo "ok $1"; }
wrong() { echo "not ok $1"; sed 's/^/    /' "$work/log"; failed=1; }
try() { label=$1; shift; if "$@" >"$work/log" 2>&1; then ok "$label"; else wrong "$label"; fi; }

command -v meson >/dev/null 2>&1 || { echo "skip install (no meson)"; exit 77; }
if ! DESTDIR="$work/root" meson install -C "$build" --no-rebuild --quiet >"$work/log" 2>&1; then wrong "meson install"; exit 1; fi
program=$(find "$work/root" -type f -name hairgrad -perm -u+x | head -n 1)
library=$(dirname "$(find "$work/root" -name libhairgrad.so | head -n 1)")
pc=$(dirname "$(find "$work/root" -name hairgrad.pc | head -n 1)")
prefix=$(dirname "$(dirname "$program")")
if [ -n "$program" ] && [ -f "$library/libhairgrad.so" ] && [ -f "$pc/hairgrad.pc" ] && [ -f "$prefix/include/hairgrad/hairgrad.h" ]; then ok "what is installed"
else find "$work/root" >"$work/log"; wrong "what is installed"; exit 1; fi
export LD_LIBRARY_PATH="$library${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}"

# nothing of the source tree: other places, only these
cd "$work" || exit 1
[ "$("$program" flags)" = "-I$prefix/include/hairgrad" ] && ok "hairgrad flags" || { "$program" flags >"$work/log" 2>&1; wrong "hairgrad flags"; }

cat >tip_rise.c <<'END'
#include "hairloss/hairloss.h"
#include "autograd/trace/names.h"
static scalar tip_rise(void) { return mul(0.5, param("stiffness"), square(max(sub(x(0).y, root_x(0).y), 0))); }
HG_ENERGY(tip_rise, .equation = "k/2 max(y - y_root, 0)^2", .source = "test", .site = window(1), .params = { { "stiffness", 0.1, "N/m" } });
END
cat >program.c <<'END'
#include "hairgrad.h"
#include <stdio.h>
int main(void)
{
    hg_ctx *ctx = NULL;
    const hg_ctx_options options = { .threads = 1 };
    if (hg_ctx_create(&ctx, &options) != HG_OK) { fprintf(stderr, "%s\n", hg_message()); return 1; }
    const double rest[6] = { 0, 0, 0, 0, 0.01, 0 }, now[6] = { 0, 0, 0, 0, 0.02, 0 };
    const hg_term term = { hg_energy_find("stretch"), 1, NULL, NULL };
    hg_groom_data data = { 0 };
    data.grooms = data.strands = 1, data.vertices = 2, data.rest = rest;
    hg_physics *physics = NULL;
    if (hg_physics_create(&physics, ctx, HG_F64, &term, 1, &data) != HG_OK) { fprintf(stderr, "%s\n", hg_message()); return 1; }
    const int64_t shape[4] = { 1, 1, 2, 3 };
    hg_tensor *x = hg_tensor_make(ctx, HG_F64, 4, shape);
    for (int i = 0; i < 6; i++) ((double *)x->data)[i] = now[i];
    const hg_frame frame = { 0 };
    double energy = 0;
    if (hg_physics_evaluate(physics, ctx, &frame, x, &energy, NULL, NULL) != HG_OK) { fprintf(stderr, "%s\n", hg_message()); return 1; }
    printf("%g\n", energy);
    hg_physics_destroy(physics);
    hg_ctx_destroy(ctx);
    return energy > 0.99e-4 && energy < 1.01e-4 ? 0 : 1;
}
END
# shellcheck disable=SC2046
try "plug-in by hairgrad flags" cc -shared -fPIC $("$program" flags) tip_rise.c -o tip_rise.so
try "its gradient" "$program" --plugin tip_rise.so gradcheck tip_rise
# shellcheck disable=SC2046
try "program by hairgrad flags" cc $sanitized $("$program" flags) program.c -o program $("$program" flags --libs)
try "it runs" ./program
if command -v pkg-config >/dev/null 2>&1; then
    export PKG_CONFIG_PATH="$pc" PKG_CONFIG_SYSROOT_DIR="$work/root"
    # shellcheck disable=SC2046
    try "plug-in by pkg-config" cc -shared -fPIC -Wall -Werror $(pkg-config --cflags hairgrad) tip_rise.c -o tip_rise.so
    try "its gradient" "$program" --plugin tip_rise.so gradcheck tip_rise
    # shellcheck disable=SC2046
    try "program by pkg-config" cc $sanitized -std=c11 -Wall -Werror -Wpedantic $(pkg-config --cflags hairgrad) program.c -o program $(pkg-config --libs hairgrad)
    try "it runs" ./program
    if command -v c++ >/dev/null 2>&1; then
        # shellcheck disable=SC2046
        try "program in C++" c++ $sanitized -x c++ -std=c++20 $(pkg-config --cflags hairgrad) program.c -x none -o program $(pkg-config --libs hairgrad)
        try "it runs" ./program
    fi
else
    echo "skip pkg-config (it is not here)"
fi
exit $failed
