#!/usr/bin/env python3
"""Runs the Rust tests and prints the slowest. Usage: tools/test_times.py [HOW_MANY]

The time of a test is wall time, with as many tests at once as there are cores.
"""

import json
import os
import re
import subprocess
import sys


def test_programs():
    """Paths of the built test programs, each with its name."""
    build = subprocess.run(
        ["cargo", "test", "--no-run", "--message-format=json"],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    for line in build.stdout.splitlines():
        message = json.loads(line)
        if message.get("executable") and message.get("profile", {}).get("test"):
            yield message["target"]["name"], message["executable"]


def times(program):
    """Seconds and name of every test of `program`."""
    # --report-time is unstable; the variable allows it for the test program alone, not for the build.
    run = subprocess.run(
        [program, "-Z", "unstable-options", "--report-time"],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "RUSTC_BOOTSTRAP": "1"},
        check=False,
    )
    found = re.findall(r"^test (\S+)(?: - .*)? \.\.\. .*?<([0-9.]+)s>", run.stdout, re.MULTILINE)
    if not found:
        sys.exit(f"{program} printed no times:\n{run.stdout}")
    return [(float(seconds), name) for name, seconds in found], run.returncode


def main():
    how_many = int(sys.argv[1]) if len(sys.argv) > 1 else 30
    all_times, failed = [], False
    for target, program in test_programs():
        found, code = times(program)
        failed |= code != 0
        print(f"{target}: {len(found)} tests, {sum(s for s, _ in found):.0f} s in all")
        all_times += found
    for seconds, name in sorted(all_times, reverse=True)[:how_many]:
        print(f"{seconds:8.2f} s  {name}")
    if failed:
        sys.exit("some tests failed")


if __name__ == "__main__":
    main()
