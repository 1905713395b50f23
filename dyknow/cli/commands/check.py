# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`check`: specification files, without a manager."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any, Dict, List, Optional, Sequence, Tuple

from dyknow.cli import completion
from dyknow.cli.command import Command
from dyknow.cli.shell import FAILED, Shell
from dyknow.cli.tables import count
from dyknow.errors import Problem

if TYPE_CHECKING:
    from dyknow.manager.specifications.ontology import Ontology

STDIN = "-"


def _check_arguments(parser: argparse.ArgumentParser) -> None:
    completion.complete_with(
        parser.add_argument(
            "files", nargs="+", metavar="FILE", help=f"specifications; {STDIN} for standard input"
        ),
        completion.files,
    )
    completion.complete_with(
        parser.add_argument(
            "--ontology",
            metavar="OWL",
            action="append",
            default=[],
            help="file in which templates find the individuals of a concept; may be repeated",
        ),
        completion.files,
    )
    completion.complete_with(
        parser.add_argument(
            "--catalogue",
            metavar="XML",
            action="append",
            default=[],
            help="XML catalogue of the ontologies that these import; may be repeated",
        ),
        completion.files,
    )
    parser.add_argument(
        "--language",
        metavar="CODE",
        default="en",
        help="language of the labels that are preferred as names (default: %(default)s)",
    )


def _check(arguments: argparse.Namespace, shell: Shell) -> Optional[int]:
    ontology = _ontology(arguments)
    unread = ontology.warnings if ontology is not None else ()
    reports = [(file, _report(file, ontology)) for file in arguments.files]
    bad = False
    lines: List[str] = [_with_warning(problem) for problem in unread]
    for file, (labels, problems, warnings) in reports:
        bad = bad or bool(problems)
        lines.extend(str(problem) for problem in problems)
        lines.extend(_with_warning(problem) for problem in warnings)
        if not problems:
            lines.append(f"{file}: {count(len(labels), 'transformation')}: {', '.join(labels)}")
    shell.show(
        {
            "files": [
                {
                    "file": file,
                    "labels": list(labels),
                    "problems": [_problem_json(problem) for problem in problems],
                    "warnings": [_problem_json(problem) for problem in warnings],
                }
                for file, (labels, problems, warnings) in reports
            ],
            "ontology_warnings": [_problem_json(problem) for problem in unread],
        },
        lines,
    )
    return FAILED if bad else None


def _ontology(arguments: argparse.Namespace) -> Optional[Ontology]:
    if not arguments.ontology:
        return None
    from dyknow.manager.specifications.ontology import load_ontology

    return load_ontology(
        arguments.ontology, language=arguments.language, catalogues=arguments.catalogue
    )


def _report(
    file: str, ontology: Optional[Ontology]
) -> Tuple[Sequence[str], Sequence[Problem], Sequence[Problem]]:
    from dyknow.errors import SpecificationError
    from dyknow.manager.specifications.specification import parse, parse_file
    from dyknow.ros.installed import missing_here

    try:
        if file == STDIN:
            found = parse(sys.stdin.buffer.read(), "standard input", ontology)
        else:
            found = parse_file(file, ontology)
    except SpecificationError as error:
        return (), error.problems, error.warnings
    missing = missing_here(file, found.transformations)
    return [each.label for each in found.transformations], (), (*found.warnings, *missing)


def _with_warning(problem: Problem) -> str:
    return str(problem._replace(message=f"warning: {problem.message}"))


def _problem_json(problem: Problem) -> Dict[str, Any]:
    return {"file": problem.file, "line": problem.line, "message": problem.message}


COMMANDS = (
    Command(
        "check",
        "check specification files without a manager",
        "Find all problems of specification files, with file and line, without a manager or a "
        "master. The exit code is 1 if there are problems; warnings are none: nodelet types, "
        "programs and message types, for instance, that this machine does not have.",
        "dyknow check cameras.xml\ndyknow check --ontology soccer.owl *.xml",
        _check_arguments,
        _check,
    ),
)
