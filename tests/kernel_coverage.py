"""Which lines of the kernels the tests reach on the emulated GPU: python3 tests/kernel_coverage.py BUILD [TEST...]

Runs the tests of the suite "cuda" with kernels compiled for counting, in forward order, and asks gcov. A line that no test reaches fails, unless
kernel_coverage.txt says why it cannot be: a line each, "file: text of the line -> why". What is explained but reached fails too."""
import concurrent.futures
import json
import os
import re
import shutil
import subprocess
import sys

SOURCE = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
EXPLAINED = os.path.join(SOURCE, "tests", "kernel_coverage.txt")


def fail(text):
    sys.exit("kernel coverage: " + text)


def run_tests(build, folder, only):
    listed = subprocess.run(["meson", "introspect", build, "--tests"], capture_output=True, text=True, check=True).stdout
    tests = [t for t in json.loads(listed) if any(s.endswith("cuda") for s in t["suite"]) and ", " not in t["name"]]
    tests = [t for t in tests if not only or t["name"].split()[0] in only]
    if not tests:
        fail("there are no tests of the suite cuda in " + build)

    def run(test):
        words = dict(os.environ, **test["env"])
        words.update(EMULATOR_COVERAGE=folder, HAIRGRAD_CACHE=os.path.join(folder, "cache"), EMULATOR_FLAGS="", EMULATOR_CHECK="0")
        words["LD_LIBRARY_PATH"] = os.pathsep.join([os.path.join(build, "tests", "emulator")] + [p for p in [os.environ.get("LD_LIBRARY_PATH")] if p])  # where there is a GPU, too
        done = subprocess.run(test["cmd"], env=words, cwd=build, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
        return test["name"], done.returncode, done.stdout

    passed = 0
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        for name, status, said in pool.map(run, tests):
            passed += len(re.findall(r"^\[       OK \]", said, re.M))
            if status not in (0, 77):
                print(said[-3000:])
                fail("%s failed" % name)
            if status == 77:
                fail("%s was skipped: %s" % (name, said.strip()[-200:]))
    return passed


def lines_of(folder):
    """{file: {line: times}} of all compilations; a file is named from the root of the source."""
    reached = {}
    tool = shutil.which("gcov") or fail("gcov is missing; it comes with gcc")
    for name in sorted(os.listdir(folder)):
        at = os.path.join(folder, name)
        if not name.startswith("emulated-nvrtc-") or not os.path.exists(os.path.join(at, "image.gcno")):
            continue
        done = subprocess.run([tool, "--json-format", "--stdout", "image.gcno"], cwd=at, capture_output=True, text=True)
        for text in done.stdout.splitlines():
            for part in json.loads(text)["files"]:
                path = os.path.normpath(os.path.join(at, part["file"]))
                path = os.path.relpath(path, at)
                if path.startswith("..") or not os.path.exists(os.path.join(SOURCE, path)):
                    continue
                counts = reached.setdefault(path, {})
                for line in part["lines"]:
                    counts[line["line_number"]] = counts.get(line["line_number"], 0) + line["count"]
    return reached


def explanations():
    said = {}
    with open(EXPLAINED, encoding="utf-8") as file:
        for number, line in enumerate(file, 1):
            if not line.strip() or line.startswith("#"):
                continue
            match = re.fullmatch(r"([^:\s]+): (.*\S) -> (\S.*)", line.rstrip("\n"))
            if not match:
                fail("kernel_coverage.txt:%d is not \"file: text of the line -> why\"" % number)
            said[match.group(1), match.group(2)] = match.group(3)
    return said


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    build, only = os.path.abspath(sys.argv[1]), sys.argv[2:]
    folder = os.path.join(build, "kernel-coverage")
    shutil.rmtree(folder, ignore_errors=True)
    os.makedirs(folder)
    passed = run_tests(build, folder, only)
    reached, said, used = lines_of(folder), explanations(), set()
    missing, all_lines, all_reached = [], 0, 0
    for path in sorted(reached):
        text = open(os.path.join(SOURCE, path), encoding="utf-8").read().splitlines()
        counts = reached[path]
        hit = sum(1 for times in counts.values() if times)
        all_lines, all_reached = all_lines + len(counts), all_reached + hit
        print("%5.1f %%  %4d of %4d  %s" % (100 * hit / len(counts), hit, len(counts), path))
        for number in sorted(n for n, times in counts.items() if not times):
            key = path, text[number - 1].strip()
            if key in said:
                used.add(key)
            else:
                missing.append("%s:%d: %s" % (path, number, key[1]))
    if not all_lines:
        fail("no line was counted")
    for folder_, _, names in os.walk(SOURCE):
        inside = os.path.relpath(folder_, SOURCE)
        if inside.split(os.sep)[0] in ("base", "tensor", "geometry", "autograd", "hairloss", "models", "scene", "train", "tasks"):
            for name in names:
                path = os.path.normpath(os.path.join(inside, name))
                if name.endswith(".kernel.h") and path not in reached:
                    if (path, "(all)") in said:
                        used.add((path, "(all)"))
                    else:
                        missing.append(path + ": no kernel of this file was compiled")
    print("kernels: %.2f %% of %d lines are reached; %d are not and are explained" % (100 * all_reached / all_lines, all_lines, all_lines - all_reached - sum(1 for m in missing if re.search(r":\d+: ", m))))
    for line in missing:
        print("not reached: " + line)
    stale = [] if only else ["%s: %s" % key for key in said if key not in used]
    for line in stale:
        print("explained, but it is reached or gone: " + line)
    if missing or stale:
        sys.exit(1)
    print("tests with counted kernels: %d passed" % passed)


main()
