#!/usr/bin/env python3
"""Runs the tests that docs/reference/faults.md names and prints its tables with their results."""

import re
import subprocess
import sys
from pathlib import Path

page = Path("docs/reference/faults.md").read_text(encoding="utf-8")
rows = [line for line in page.splitlines() if re.match(r"\| \d+ \|", line)]
names = sorted({name for row in rows for name in re.findall(r"`([a-z_0-9]+)`", row.split("|")[-2])})
run = subprocess.run(
    ["cargo", "test", "--no-fail-fast", "--lib", "--test", "it", "--", *names],
    stdout=subprocess.PIPE,
    text=True,
    check=False,
)
results = {
    path.rsplit("::", 1)[-1]: outcome
    for path, outcome in re.findall(r"^test (\S+) \.\.\. (ok|FAILED)$", run.stdout, re.MULTILINE)
}
bad = 0
for row in rows:
    number, fault, reaction, tests = (cell.strip() for cell in row.strip("|").split("|"))
    outcomes = {name: results.get(name, "not run") for name in re.findall(r"`([a-z_0-9]+)`", tests)}
    failed = [f"{name} ({outcome})" for name, outcome in outcomes.items() if outcome != "ok"]
    bad += bool(failed)
    verdict = "FAILED: " + ", ".join(failed) if failed else "right"
    print(f"{number:>2}  {fault}: {reaction} | {len(outcomes)} tests | {verdict}")
print(f"{len(rows) - bad} of {len(rows)} right")
sys.exit(1 if bad else 0)
