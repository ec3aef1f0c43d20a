#!/bin/sh
# The PTX that the real NVRTC makes of the kernels, run on the emulated driver: the tests of ops, energies and fields again.
# Skipped where there is no NVRTC, or no emulated driver.
build=$1
find_nvrtc() { # the folder of a libnvrtc that is not the emulated one
    for folder in "${CUDA_HOME:-/usr/local/cuda}/lib64" "${CUDA_HOME:-/usr/local/cuda}/lib" $(ldconfig -p 2>/dev/null | awk '/libnvrtc\.so/ { print $NF }' | xargs -r -n1 dirname); do
        for library in "$folder"/libnvrtc.so.1[2-9]; do [ -e "$library" ] && { echo "$folder"; return 0; }; done
    done
    return 1
}
nvrtc=$(find_nvrtc) || { echo "PTX: there is no NVRTC of CUDA 12 or later here"; exit 77; }
[ -e "$build/tests/emulator/libcuda.so.1" ] || { echo "PTX: the emulated driver was not built (no C++ compiler)"; exit 77; }
folder=$(mktemp -d) || exit 1
trap 'rm -rf "$folder"' EXIT
for library in "$build"/tests/emulator/*.so.*; do
    case $library in *nvrtc*) ;; *.p) ;; *) ln -s "$library" "$folder/" ;; esac
done
wrong=0
for test in ${PTX_TESTS:-test_ops test_product test_validate test_grid test_energies test_passes test_body_tree test_pose}; do
    [ -x "$build/tests/$test" ] || continue
    grep -q 'test_device()' "$HG_SOURCE/tests/$test.c" || continue
    if HG_TEST_DEVICE=cuda EMULATOR_CAPABILITY=99 EMULATOR_ORDER=2 LD_LIBRARY_PATH="$folder:$nvrtc" "$build/tests/$test" >"$folder/log" 2>&1; then
        echo "PTX: $test: $(grep -c '\[       OK' "$folder/log") passed"
    else
        echo "PTX: $test failed"
        tail -n 30 "$folder/log"
        wrong=1
    fi
done
exit $wrong
