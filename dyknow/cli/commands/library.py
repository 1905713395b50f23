# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`library`, `import`, `export`, `remove` and `check`: the transformations."""

from __future__ import annotations

import argparse
import re
from typing import TYPE_CHECKING, Sequence

from dyknow.cli.arguments import REPEATED, Argument, argument, flag
from dyknow.cli.output import (
    STDIO,
    Json,
    columns,
    count,
    read_file,
    transformation_json,
    write_file,
)
from dyknow.cli.shell import FAILED, Acted, Shell, command
from dyknow.errors import DyKnowError, Problem, Refused, UnknownTransformation
from dyknow.model.transformation import IN, OUT, Transformation, as_specification
from dyknow.similar import did_you_mean

if TYPE_CHECKING:
    from dyknow.manager.specifications.ontologies.ontology import Ontology


def _labels(nargs: str, text: str) -> Argument:
    return argument("labels", "LABEL", text, nargs=nargs)


_FILES = argument("files", "FILE", f"specifications; {STDIO} for standard input", nargs="+")


@command(
    "List the labels of the transformations, one a line, or show the specifications of some.",
    "dyknow library\ndyknow library -l\ndyknow library 'undistort(cam1)'",
    _labels("*", "show the specification (default: list the labels)"),
    flag("-l --long", "show source, ports and cost"),
)
def _library(arguments: argparse.Namespace, shell: Shell) -> int | None:
    chosen, code = _chosen(shell, arguments.labels)
    value = {"transformations": [transformation_json(each) for each in chosen]}
    if arguments.labels and not arguments.long:
        shell.show_file(value, "".join(each.to_xml() for each in chosen))
    else:
        shell.show(value, _long_list(chosen) if arguments.long else [it.label for it in chosen])
    return code


def _long_list(transformations: Sequence[Transformation]) -> list[str]:
    rows: list[tuple[object, ...]] = [("LABEL", "TYPE", "SOURCE", "COST", "IN", "OUT")]
    for each in transformations:
        directions = [port.direction for port in each.ports]
        ends = directions.count(IN), directions.count(OUT)
        rows.append((each.label, each.type, each.node or each.source, each.cost, *ends))
    return columns(rows, right=(3, 4, 5))


def _chosen(shell: Shell, labels: Sequence[str]) -> tuple[list[Transformation], int | None]:
    """Return the transformations of some labels, by default all; and FAILED if some are unknown.

    Those are named.
    """
    known = {each.label: each for each in shell.client.get_model().transformations}
    asked = dict.fromkeys(labels or known)
    unknown = [label for label in asked if label not in known]
    for label in unknown:
        shell.error(UnknownTransformation(label, did_you_mean(label, known)))
    return [known[label] for label in asked if label in known], FAILED if unknown else None


@command(
    "Add the transformations that files specify. One under an existing label replaces it; "
    "nodelets keep the one that they were made from. A file with a problem adds nothing.",
    "dyknow import cameras.xml\ndyknow export | ROS_MASTER_URI=http://other:11311 dyknow import -",
    _FILES,
)
def _import(arguments: argparse.Namespace, shell: Shell) -> int | None:
    def add(file: str) -> Acted:
        try:
            added = shell.client.add_transformation(_read(file))
        except Refused as error:
            raise DyKnowError(_named(file, str(error))) from error
        warnings = _named(file, added.warnings)
        shell.warn(warnings)
        shown = {"file": file, "labels": list(added.labels), "warnings": warnings.splitlines()}
        return [shown], [f"{file}: {label}" for label in added.labels]

    return shell.for_each("file", "imported", arguments.files, add)


def _read(file: str) -> str:
    try:
        return read_file(file).decode("utf-8")
    except UnicodeDecodeError as error:
        raise DyKnowError(f"{file}: is not UTF-8; expected XML in UTF-8") from error


def _named(file: str, words: str) -> str:
    """Replace `specification`, the manager's name for it, by the name of the file."""
    return re.sub(r"^specification(?=:)", lambda _: file, words, flags=re.MULTILINE)


@command(
    "Write transformations as one specification, which 'import' reads. With an unknown label "
    "nothing is written.",
    "dyknow export > library.xml\ndyknow export 'undistort(cam1)' relay -o some.xml",
    _labels("*", "what to export (default: all)"),
    argument("-o --output", "FILE", f"write here (default: {STDIO}, print)"),
)
def _export(arguments: argparse.Namespace, shell: Shell) -> int | None:
    chosen, code = _chosen(shell, arguments.labels)
    if code:
        return code
    text = as_specification(chosen)
    labels = [each.label for each in chosen]
    if arguments.output and arguments.output != STDIO:
        write_file(arguments.output, text.encode("utf-8"))
        shell.show(
            {"file": arguments.output, "labels": labels},
            [f"wrote {count(len(chosen), 'transformation')} to {arguments.output}"],
        )
    else:
        shell.show_file({"labels": labels, "specification": text}, text)
    return None


@command(
    "Remove transformations from the library. Nodelets that were made from them run on.",
    "dyknow remove 'undistort(cam1)'",
    _labels("+", "what to remove; nodelets made from it run on"),
)
def _remove(arguments: argparse.Namespace, shell: Shell) -> int | None:
    return shell.for_each("label", "removed", arguments.labels, shell.client.remove_transformation)


@command(
    "Find all problems of specification files, with file and line, without a manager or a "
    "master. The exit code is 1 if there are problems; warnings are none: nodelet types, "
    "programs and message types, for instance, that this machine does not have.",
    "dyknow check cameras.xml\ndyknow check --ontology soccer.owl *.xml",
    _FILES,
    argument(
        "--ontology",
        "OWL",
        "file in which templates find the individuals of a concept; may be repeated",
        **REPEATED,
    ),
    argument(
        "--catalogue",
        "XML",
        "XML catalogue of the ontologies that these import; may be repeated",
        **REPEATED,
    ),
    argument(
        "--language",
        "CODE",
        "language of the labels that are preferred as names (default: %(default)s)",
        default="en",
    ),
)
def _check(arguments: argparse.Namespace, shell: Shell) -> int | None:
    ontology: Ontology | None = None
    if arguments.ontology:
        from dyknow.manager.specifications.ontologies.ontology import Ontology

        ontology = Ontology(
            arguments.ontology, language=arguments.language, catalogues=arguments.catalogue
        )
    unread = ontology.warnings if ontology is not None else ()
    shown: list[Json] = []
    lines: list[str] = [_with_warning(problem) for problem in unread]
    for file in arguments.files:
        labels, problems, warnings = _report(file, ontology)
        lines.extend(map(str, problems))
        lines.extend(map(_with_warning, warnings))
        if not problems:
            lines.append(f"{file}: {count(len(labels), 'transformation')}: {', '.join(labels)}")
        shown.append(
            {
                "file": file,
                "labels": list(labels),
                "problems": [problem._asdict() for problem in problems],
                "warnings": [problem._asdict() for problem in warnings],
            }
        )
    shell.show(
        {"files": shown, "ontology_warnings": [problem._asdict() for problem in unread]}, lines
    )
    return FAILED if any(each["problems"] for each in shown) else None


def _report(
    file: str, ontology: Ontology | None
) -> tuple[Sequence[str], Sequence[Problem], Sequence[Problem]]:
    from dyknow.errors import SpecificationError
    from dyknow.manager.specifications.specification import parse, parse_file
    from dyknow.ros.formulas.message_types import message_type
    from dyknow.ros.hosting.installed import missing_here

    try:
        if file == STDIO:
            found = parse(read_file(file), "standard input", ontology, types=message_type)
        else:
            found = parse_file(file, ontology, types=message_type)
    except SpecificationError as error:
        return (), error.problems, error.warnings
    missing = missing_here(file, found.transformations)
    return [each.label for each in found.transformations], (), (*found.warnings, *missing)


def _with_warning(problem: Problem) -> str:
    return str(problem._replace(message=f"warning: {problem.message}"))
