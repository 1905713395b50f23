# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`doctor`: the defects of a system, and their cures."""

from __future__ import annotations

import argparse
from typing import Dict, List, Optional

from dyknow.cli.command import Command
from dyknow.cli.shell import FAILED, Shell
from dyknow.cli.tables import count
from dyknow.errors import DyKnowError


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "-q", "--quiet", action="store_true", help="do not list the checks without a finding"
    )


def _doctor(arguments: argparse.Namespace, shell: Shell) -> Optional[int]:
    from dyknow.ros.doctor import Doctor, Finding  # rospy takes its time to import

    shell.client.managers()  # without a ROS master there is nothing to examine
    found: Dict[str, List[Finding]] = {}
    lines: List[str] = []
    for name, check in Doctor(shell.client).checks():
        try:
            found[name] = list(check())
        except (DyKnowError, LookupError) as error:
            found[name] = [Finding(name, f"cannot be examined: {error}", "run doctor again")]
        if not found[name] and not arguments.quiet:
            lines.append(f"ok       {name}")
        for each in found[name]:
            lines.append(
                f"{'ERROR' if each.is_error else 'warning':7}  {each.subject}: {each.problem}"
            )
            lines.append(f"         cure: {each.cure}")
    findings = [each for several in found.values() for each in several]
    errors = sum(each.is_error for each in findings)
    lines.append(
        f"{count(len(found), 'check')}: {count(errors, 'error')}, "
        f"{count(len(findings) - errors, 'warning')}"
    )
    shell.show(
        {
            "checks": list(found),
            "findings": [
                {
                    "check": name,
                    "subject": each.subject,
                    "problem": each.problem,
                    "cure": each.cure,
                    "is_error": each.is_error,
                }
                for name, several in found.items()
                for each in several
            ],
        },
        lines,
    )
    return FAILED if findings else None


COMMANDS = (
    Command(
        "doctor",
        "find the defects of a system, and their cures",
        "Examine the system: names of hosts, dead registrations, processes that another ROS "
        "master knows, nodelets and streams that fail or hang, missing guards, unknown sources "
        "and types, parameters that nothing reads, processes of another version, file "
        "descriptors and disks. Nothing is changed. The exit code is 1 if anything was found.",
        "dyknow doctor\ndyknow doctor --quiet\n"
        "dyknow doctor --json | jq -r '.findings[] | select(.is_error) | .cure'",
        _arguments,
        _doctor,
    ),
)
