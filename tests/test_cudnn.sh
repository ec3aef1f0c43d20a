#!/bin/sh
# Without a cuDNN that can be used the rest of CUDA works, and a convolution says what is missing. $1 is the build folder.
build=$(cd "$1" && pwd) || exit 1
emulator="$build/tests/emulator"
[ -e "$emulator/libcuda.so.1" ] || { echo "skipped: there is no emulated GPU here (no C++ compiler)"; exit 77; }
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
for library in libcuda.so.1 libnvrtc.so.13 libcublas.so.13; do ln -s "$emulator/$library" "$work/"; done
export LD_LIBRARY_PATH="$work:$build" ASAN_OPTIONS="${ASAN_OPTIONS:+$ASAN_OPTIONS:}verify_asan_link_order=0"
failed=0
refuses() { # LABEL PATTERN
    if "$build/hairgrad" gradcheck conv2d --device cuda > "$work/log" 2>&1; then
        echo "not ok $1: no error"; failed=1
    elif grep -Eq -- "$2" "$work/log"; then
        echo "ok $1"
    else
        echo "not ok $1"; sed 's/^/    /' "$work/log"; failed=1
    fi
}
installed() { ldconfig -p | grep -q 'libcudnn\.so\.9' || ls "${CUDA_HOME:-/}"/lib64/libcudnn.so.9 "${CUDA_PATH:-/}"/lib64/libcudnn.so.9 /usr/local/cuda/lib64/libcudnn.so.9; }
if installed > "$work/log" 2>&1; then
    echo "ok a cuDNN that is missing: not tried, one is installed here"
else
    refuses "a cuDNN that is missing" 'convolutions need cuDNN 9, libcudnn.so.9, which is missing'
fi
ln -s "$emulator/libcublas.so.13" "$work/libcudnn.so.9" # in front of one that is installed
refuses "a cuDNN that is none" 'cudnn[A-Za-z]* is missing in the libcudnn.so.9 that was found'
if "$build/hairgrad" gradcheck upsample --device cuda > "$work/log" 2>&1; then
    echo "ok upsample works without cuDNN"
else
    echo "not ok upsample works without cuDNN"; sed 's/^/    /' "$work/log"; failed=1
fi
exit $failed
