# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Reads the result files of tests: XML as JUnit writes it, by pytest and by rosunit."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

MOST_SHOWN = 160  # characters of a reason


@dataclass(frozen=True)
class Report:
    """What a result file says."""

    passed: int = 0
    skipped: int = 0
    failures: tuple[str, ...] = ()  # of each test its name and the reason, in a line
    printed: str = ""  # by the tests, as far as the file holds it for all of them together


def read_report(path: Path) -> Report:
    """Reads a result file; one that is missing or torn reports no tests."""
    try:
        root = ElementTree.parse(path).getroot()
    except (OSError, ElementTree.ParseError):
        return Report()
    cases = list(root.iter("testcase"))
    skipped = sum(case.find("skipped") is not None for case in cases)
    failures = tuple(filter(None, map(_failure, cases)))
    printed = ""
    for element in root:
        if element.tag in ("system-out", "system-err"):
            # rosunit writes the markers of a CDATA section as if they were text.
            text = re.sub(r"<!\[CDATA\[|\]\]>", "", element.text or "").strip()
            printed += f"\n{path.stem}, {element.tag}:\n{text}\n" if text else ""
    return Report(len(cases) - skipped - len(failures), skipped, failures, printed)


def _failure(case: ElementTree.Element) -> str:
    for element in case:
        if element.tag in ("failure", "error"):
            return f"{case.get('name')}: {_reason(element)[:MOST_SHOWN]}"
    return ""


def _reason(element: ElementTree.Element) -> str:
    """The message, which pytest writes; else the last place of the traceback: rosunit's."""
    message = element.get("message", "").strip()
    if message:
        return message.splitlines()[0]
    places = re.findall(
        r'File "(?![^"]*/unittest/)[^"]*?([^"/]+)", line (\d+).*\n *(.*)', element.text or ""
    )
    return "{}:{}: {}".format(*places[-1]) if places else element.get("type", "no reason given")
