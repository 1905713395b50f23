# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Adds the SPDX lines to source files that do not have them; ``--check`` lists these instead."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Iterator

ROOT = Path(__file__).resolve().parent.parent
LINES = (
    "SPDX-FileCopyrightText: 2026 the DyKnow developers",
    "SPDX-License-Identifier: BSD-3-Clause",
)
#: How a line of comment begins, by the end of a file's name.
COMMENTS = {
    ".bash": "#",
    ".cmake": "#",
    ".cmake.in": "#",
    ".cpp": "//",
    ".h": "//",
    ".py": "#",
    ".sh": "#",
    ".develspace.in": "#",
    ".installspace.in": "#",
    "CMakeLists.txt": "#",
    "Makefile": "#",
}
#: To be copied, or shown line by line on a page; and folders that hold no sources of ours.
LEFT_OUT = ("examples/convert", "examples/skeleton", "build")


def sources() -> Iterator[tuple[Path, str]]:
    """The source files, sorted, each with how a line of comment begins in it."""
    for path in sorted(ROOT.rglob("*")):
        name = path.relative_to(ROOT).as_posix()
        hidden = any(part.startswith(".") for part in name.split("/"))
        if hidden or any(name == each or name.startswith(each + "/") for each in LEFT_OUT):
            continue
        if not path.is_file():
            continue
        comment = next((COMMENTS[end] for end in COMMENTS if name.endswith(end)), "")
        if not comment and "." not in path.name and path.read_bytes().startswith(b"#!"):
            comment = "#"
        if comment:
            yield path, comment


def lacks_lines(text: str, comment: str) -> bool:
    """Whether the lines are not at the beginning of a file, after the line that runs it."""
    return header(comment) not in text[:300]


def header(comment: str) -> str:
    """The lines as a comment."""
    return "".join(f"{comment} {line}\n" for line in LINES)


def with_lines(text: str, comment: str) -> str:
    """The text of a file with the lines, after the line that runs it if there is one."""
    first, rest = "", text
    if text.startswith("#!"):
        first, _, rest = text.partition("\n")
        first += "\n"
    gap = "\n" if rest.strip() and not rest.startswith("\n") else ""
    return first + header(comment) + gap + rest


def main() -> int:
    """Adds the lines, or lists the files that lack them; returns 1 if it lists any."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="change nothing")
    check = parser.parse_args().check
    lacking = [
        (path, comment)
        for path, comment in sources()
        if lacks_lines(path.read_text(encoding="utf-8"), comment)
    ]
    for path, comment in lacking:
        if check:
            print(f"{path.relative_to(ROOT)}: no SPDX lines; run tools/spdx.py")
        else:
            text = path.read_text(encoding="utf-8")
            path.write_text(with_lines(text, comment), encoding="utf-8")
    return 1 if check and lacking else 0


if __name__ == "__main__":
    sys.exit(main())
