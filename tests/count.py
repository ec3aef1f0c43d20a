#!/usr/bin/env python3
"""Adds up the results of `meson test`: single cases of the C programs and shell tests, not only programs.

    count.py build/meson-logs/testlog.json LABEL      prints failures, then "PASSED FAILED SKIPPED" on the last line
"""
import json
import re
import sys

passed = failed = skipped = 0
for line in open(sys.argv[1], encoding="utf-8", errors="replace"):
    record = json.loads(line)
    text = re.sub(r"\x1b\[[0-9;]*m", "", record.get("stdout", "") + "\n" + record.get("stderr", ""))
    ok = len(re.findall(r"^\[       OK \]|^ok ", text, re.M))
    names = set(re.findall(r"^\[  FAILED  \] (?!.*test\(s\))(\S+)|^not ok (.+)", text, re.M))
    left_out = set(re.findall(r"^\[  SKIPPED \] (?!.*test\(s\))(\S+)|^skip (.+)", text, re.M))
    result = record["result"]
    if result in ("OK", "EXPECTEDFAIL"):
        ok = ok or (0 if left_out else 1)
    elif result == "SKIP":
        left_out = left_out or {record["name"]}
    elif not names:
        names = {(record["name"], result)}
    passed, failed, skipped = passed + ok, failed + len(names), skipped + len(left_out)
    if names:
        print(f"---- {sys.argv[2]}: {record['name']} ({result}):", ", ".join(sorted("".join(name) for name in names)))
        print("\n".join(text.strip().splitlines()[-60:]))
print(passed, failed, skipped)
