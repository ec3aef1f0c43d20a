#!/bin/sh
# Without cuDNN the rest of CUDA works, and a convolution says what is missing. $1 is the build folder.
build=$(cd "$1" && pwd) || exit 1
emulator="$build/tests/emulator"
[ -e "$emulator/libcuda.so.1" ] || { echo "skipped: there is no emulated GPU here (no C++ compiler)"; exit 77; }
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
for library in "$emulator"/*.so.*; do ln -s "$library" "$work/"; done
rm "$work/libcudnn.so.9" && echo "no library" > "$work/libcudnn.so.9" # in front of one that may be installed
export LD_LIBRARY_PATH="$work:$build" ASAN_OPTIONS="${ASAN_OPTIONS:+$ASAN_OPTIONS:}verify_asan_link_order=0"
failed=0
check() { # LABEL PATTERN
    if grep -Eq -- "$2" "$work/log"; then echo "ok $1"; else echo "not ok $1"; sed 's/^/    /' "$work/log"; failed=1; fi
}
"$build/hairgrad" gradcheck conv2d --device cuda > "$work/log" 2>&1 && { echo "not ok conv2d without cuDNN is an error"; failed=1; }
check "conv2d says what it needs" 'convolutions need cuDNN 9.*libcudnn.so.9'
"$build/hairgrad" gradcheck upsample --device cuda > "$work/log" 2>&1 || { echo "not ok upsample without cuDNN"; failed=1; }
check "upsample works without it" ' right, 0 wrong'
exit $failed
