#!/bin/sh
# Every CUDA kernel through the real NVRTC where there is one: no warning, no spill. Skipped where there is none.
exec python3 "$HG_SOURCE/tests/kernel_registers.py" "$1"
