#!/bin/sh
# on_cuda.sh PROGRAM WAY: a test program on a GPU, or on the emulated one where there is none. WAY is the order in which the
# emulator runs threads and blocks (forward, shuffled), or checked: in reverse order, and it looks at every access of a kernel.
program=$1 way=$2
works() { "$HG_BUILD/hairgrad" devices 2>/dev/null | grep '^cuda' | grep -qv 'not usable'; }
if works; then
    [ "$way" = forward ] || exit 77 # a GPU has its own order
    export HG_TEST_GPU=1
elif [ -e "$HG_BUILD/tests/emulator/libcuda.so.1" ]; then
    export LD_LIBRARY_PATH="$HG_BUILD/tests/emulator${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}"
    works || { echo "the emulated driver does not work: $("$HG_BUILD/hairgrad" devices 2>&1)"; exit 1; }
else
    echo "neither a GPU nor an emulated one (no C++ compiler)"
    exit 77
fi
case $way in
    forward) EMULATOR_ORDER=0 ;;
    shuffled) EMULATOR_ORDER=2 ;;
    checked) EMULATOR_ORDER=1 EMULATOR_CHECK=1 ;;
    *) echo "unknown way $way"; exit 1 ;;
esac
export HG_TEST_DEVICE=cuda EMULATOR_ORDER ${EMULATOR_CHECK:+EMULATOR_CHECK}
exec "$program"
