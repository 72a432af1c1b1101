#!/usr/bin/env python3
"""Counts lines of Rust: production code and tests, and how long files are. Usage: tools/code_figures.py [CHECKOUT]

A test is a file of tests/it, a file behind `#[cfg(test)] mod x;`, or what follows `#[cfg(test)] mod x {` in a file.
"""

import re
import sys
from pathlib import Path

INLINE_TESTS = re.compile(r"^#\[cfg\(test\)\]\n(?:#\[.*\]\n)*mod \w+ \{", re.MULTILINE)
FILE_OF_TESTS = re.compile(r'#\[cfg\(test\)\]\s*(?:#\[path = "([^"]+)"\]\s*)?(?:pub(?:\([^)]*\))? )?mod (\w+);')


def files_of_tests(path, text):
    """Files and folders that `text` declares as modules for tests only."""
    folder = path.parent if path.name in ("mod.rs", "lib.rs", "main.rs") else path.with_suffix("")
    for named, module in FILE_OF_TESTS.findall(text):
        file = path.parent / named if named else folder / f"{module}.rs"
        yield file
        yield file.with_suffix("")


def main():
    root = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    sources = {path: path.read_text() for path in sorted((root / "src").rglob("*.rs"))}
    for_tests = {place for path, text in sources.items() for place in files_of_tests(path, text)}
    production, tests = {}, 0
    for path, text in sources.items():
        lines = text.count("\n")
        if path in for_tests or any(parent in for_tests for parent in path.parents):
            tests += lines
            continue
        begin = INLINE_TESTS.search(text)
        production[path] = text.count("\n", 0, begin.start()) if begin else lines
        tests += lines - production[path]
    outside = sum(path.read_text().count("\n") for path in (root / "tests" / "it").rglob("*.rs"))
    lengths = sorted(production.values())
    print(f"production lines   {sum(lengths)} in {len(lengths)} files of src")
    print(f"test lines         {tests} in src, {outside} in tests/it")
    print(f"lines per file     median {lengths[len(lengths) // 2]}, 90 % below {lengths[len(lengths) * 9 // 10]}")
    longest = sorted(((n, path) for path, n in production.items() if n > 500), reverse=True)
    print(f"files over 500     {len(longest)}")
    for lines, path in longest:
        print(f"    {lines:5} {path.relative_to(root)}")


if __name__ == "__main__":
    main()
