#!/usr/bin/env python3
"""Compiles every CUDA kernel with the real NVRTC, for sm_80, sm_90 and sm_120, and says what each takes.

    kernel_registers.py BUILD [--write docs/cuda-kernels.md]

Files of kernels (*.kernel.h) and the printed kernels of the usual sums of energies. A warning or a spill is a failure. Exits with
77 where there is no NVRTC. Needs nothing but the standard library."""
import ctypes
import ctypes.util
import glob
import os
import re
import subprocess
import sys

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
ARCHITECTURES = (80, 90, 120)
SUMS = ["stretch bend_twist gravity inertia", "stretch bend_twist gravity inertia body_collision",
        "bend_twist", "bend_twist_chain", "shear", "cosserat_stretch_shear cosserat_bend_twist unit_quaternion",
        "spring_edge spring_bend spring_torsion", "integrity angular"]
INTEGERS = ("typedef signed char int8_t; typedef unsigned char uint8_t; typedef short int16_t; typedef unsigned short uint16_t; "
            "typedef int int32_t; typedef unsigned uint32_t; typedef long long int64_t; typedef unsigned long long uint64_t;")


def find_nvrtc():
    folders = [os.path.join(os.environ.get("CUDA_HOME", "/usr/local/cuda"), "lib64")]
    for path in sum((sorted(glob.glob(f + "/libnvrtc.so*")) for f in folders), []) + ["libnvrtc.so.13", "libnvrtc.so.12"]:
        try:
            library = ctypes.CDLL(path)
        except OSError:
            continue
        major, minor = ctypes.c_int(), ctypes.c_int()
        library.nvrtcVersion(ctypes.byref(major), ctypes.byref(minor))
        if major.value >= 12:  # an emulated one is version 0
            return library, f"{major.value}.{minor.value}"
    return None, None


def headers():
    found = {}
    for folder in ("tensor", "geometry", "autograd", "hairloss", "models", "scene", "train", "tasks"):
        for path in glob.glob(os.path.join(ROOT, folder, "**", "*"), recursive=True):
            if path.endswith((".h", ".inc")):
                found[os.path.relpath(path, ROOT)] = open(path, encoding="utf-8").read()
    found.update({"math.h": "", "string.h": "", "stdint.h": INTEGERS})
    return found


def compile_one(nvrtc, source, given, architecture):
    """Log of NVRTC and ptxas, and whether it compiled."""
    program = ctypes.c_void_p()
    names = (ctypes.c_char_p * len(given))(*[n.encode() for n in given])
    texts = (ctypes.c_char_p * len(given))(*[t.encode() for t in given.values()])
    options = [f"--gpu-architecture=sm_{architecture}", "--std=c++17", "-DHG_CUDA=1", "--ptxas-options=-v"]
    words = (ctypes.c_char_p * len(options))(*[o.encode() for o in options])
    nvrtc.nvrtcCreateProgram(ctypes.byref(program), source.encode(), b"kernels", len(given), texts, names)
    result = nvrtc.nvrtcCompileProgram(program, len(options), words)
    size = ctypes.c_size_t()
    nvrtc.nvrtcGetProgramLogSize(program, ctypes.byref(size))
    log = ctypes.create_string_buffer(size.value + 1)
    nvrtc.nvrtcGetProgramLog(program, log)
    nvrtc.nvrtcDestroyProgram(ctypes.byref(program))
    return log.value.decode(), result == 0


def read_log(log):
    """(kernel, registers, shared, stack, spills) of each entry function."""
    rows = []
    for block in re.split(r"Compiling entry function ", log)[1:]:
        name = re.match(r"'([^']+)'", block).group(1)
        used = re.search(r"Used (\d+) registers", block)
        shared = re.search(r"(\d+) bytes smem", block)
        stack = re.search(r"(\d+) bytes stack frame, (\d+) bytes spill stores, (\d+) bytes spill loads", block)
        rows.append((name, int(used.group(1)) if used else 0, int(shared.group(1)) if shared else 0, int(stack.group(1)) if stack else 0,
                     int(stack.group(2)) + int(stack.group(3)) if stack else 0))
    return rows


def main():
    build = sys.argv[1] if len(sys.argv) > 1 else "build"
    write = sys.argv[sys.argv.index("--write") + 1] if "--write" in sys.argv else None
    nvrtc, version = find_nvrtc()
    if not nvrtc:
        print("kernel registers: there is no NVRTC of CUDA 12 or later here")
        return 77
    given = headers()
    sources = [(name, f'#include "{name}"\n') for name in sorted(given) if name.endswith(".kernel.h")]
    for energies in SUMS:
        for dtype in ("f32", "f64"):
            made = subprocess.run([os.path.join(build, "hairgrad"), "trace", *energies.split(), "--cuda", "--dtype", dtype], capture_output=True, text=True)
            if made.returncode:
                print(f"{energies}: {made.stderr.strip()}")
                return 1
            text = f'#include "tensor/kernel.h"\n{made.stdout}'  # as tensor/cuda/module.c does with a text
            sources.append((f"{energies.replace(' ', ' + ')} ({dtype})", text))
    table, failures = {}, 0
    for name, source in sources:
        for architecture in ARCHITECTURES:
            log, good = compile_one(nvrtc, source, given, architecture)
            if not good or re.search(r"\bwarning\b", log):
                print(f"---- {name}, sm_{architecture}:\n{log[:3000]}")
                failures += 1
            for kernel, registers, shared, stack, spills in read_log(log):
                table.setdefault((name, kernel), {})[architecture] = (registers, shared, stack, spills)
                if spills:
                    print(f"---- {name}: {kernel} spills {spills} bytes on sm_{architecture}")
                    failures += 1
    lines = ["# What the CUDA kernels take", "",
             f"Made by `tests/kernel_registers.py BUILD --write docs/cuda-kernels.md` with NVRTC {version}; nothing spills, or the test fails.",
             "Registers a thread on sm_80 / sm_90 / sm_120; static shared memory and stack in bytes (sm_90).", "",
             "| from | kernel | registers | shared | stack |", "|---|---|---|---|---|"]
    for (name, kernel), found in table.items():
        registers = " / ".join(str(found[a][0]) if a in found else "-" for a in ARCHITECTURES)
        middle = found.get(90, (0, 0, 0, 0))
        lines.append(f"| {name} | {kernel} | {registers} | {middle[1]} | {middle[2]} |")
    if write:
        with open(write, "w", encoding="utf-8") as file:
            file.write("\n".join(lines) + "\n")
    print(f"kernel registers: {len(table)} kernels for {len(ARCHITECTURES)} architectures, {failures} failures")
    return 1 if failures else 0


sys.exit(main())
