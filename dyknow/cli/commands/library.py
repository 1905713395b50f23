# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`library`, `import`, `export`, `remove` and `check`: the transformations."""

from __future__ import annotations

import argparse
import re
import sys
from typing import TYPE_CHECKING, Iterable, Sequence

from dyknow.cli.arguments import Argument, argument, flag
from dyknow.cli.output import Json, columns, count, transformation_json, write_file
from dyknow.cli.shell import FAILED, Shell, command
from dyknow.errors import ManagerUnreachable, Problem, Refused, UnknownTransformation
from dyknow.model.transformation import IN, OUT, Transformation
from dyknow.similar import did_you_mean

if TYPE_CHECKING:
    from dyknow.manager.specifications.ontology import Ontology


STDIN = "-"


def _labels(nargs: str, text: str) -> Argument:
    return argument("labels", "LABEL", text, nargs=nargs)


_FILES = argument("files", "FILE", f"specifications; {STDIN} for standard input", nargs="+")


@command(
    "library",
    "list the transformations, or show specifications",
    "List the labels of the transformations, one a line, or show the specifications of some.",
    "dyknow library\ndyknow library -l\ndyknow library 'undistort(cam1)'",
    _labels("*", "show the specification (default: list the labels)"),
    flag("-l --long", "show source, ports and cost"),
)
def _library(arguments: argparse.Namespace, shell: Shell) -> None:
    chosen = _chosen(shell, arguments.labels)
    if arguments.long:
        lines: Iterable[str] = _long_list(chosen)
    elif arguments.labels:
        lines = (each.to_xml().rstrip("\n") for each in chosen)
    else:
        lines = (each.label for each in chosen)
    shell.show({"transformations": [transformation_json(each) for each in chosen]}, lines)


def _long_list(transformations: Sequence[Transformation]) -> list[str]:
    rows: list[tuple[object, ...]] = [("LABEL", "TYPE", "SOURCE", "COST", "IN", "OUT")]
    for each in transformations:
        directions = [port.direction for port in each.ports]
        ends = directions.count(IN), directions.count(OUT)
        rows.append((each.label, each.type, each.node or each.source, each.cost, *ends))
    return columns(rows, right=(3, 4, 5))


def _chosen(shell: Shell, labels: Sequence[str]) -> list[Transformation]:
    known = {each.label: each for each in shell.client.get_model().transformations}
    if not labels:
        return list(known.values())
    unknown = [label for label in labels if label not in known]
    for label in unknown[1:]:
        shell.error(UnknownTransformation(label, did_you_mean(label, known)))
    if unknown:
        raise UnknownTransformation(unknown[0], did_you_mean(unknown[0], known))
    return [known[label] for label in dict.fromkeys(labels)]


@command(
    "import",
    "add transformations from specification files",
    "Add the transformations that files specify. One under an existing label replaces it; "
    "nodelets keep the one that they were made from. A file with a problem adds nothing.",
    "dyknow import cameras.xml\ndyknow export | ROS_MASTER_URI=http://other:11311 dyknow import -",
    _FILES,
)
def _import(arguments: argparse.Namespace, shell: Shell) -> int | None:
    imported: list[Json] = []
    failed: list[Json] = []
    for file in arguments.files:
        try:
            added = shell.client.add_transformation(_read(file))
        except ManagerUnreachable:
            raise
        except (OSError, UnicodeDecodeError, Refused) as error:
            message = _explain(file, error)
            failed.append({"file": file, "message": message})
            for line in message.splitlines():
                shell.error(line)
        else:
            warnings = _named(file, added.warnings).splitlines()
            imported.append({"file": file, "labels": list(added.labels), "warnings": warnings})
            for warning in warnings:
                shell.warn(warning)
    shell.show(
        {"imported": imported, "failed": failed},
        [f"{each['file']}: {label}" for each in imported for label in each["labels"]],
    )
    return FAILED if failed else None


def _read(file: str) -> str:
    if file == STDIN:
        return sys.stdin.buffer.read().decode("utf-8")
    with open(file, encoding="utf-8") as opened:
        return opened.read()


def _explain(file: str, error: Exception) -> str:
    """Return the problems of a file, a line each."""
    if isinstance(error, OSError):
        return f"{file}: cannot be read: {error.strerror}"
    if isinstance(error, UnicodeDecodeError):
        return f"{file}: is not UTF-8; expected XML in UTF-8"
    return _named(file, str(error))


def _named(file: str, words: str) -> str:
    """Replace `specification`, the manager's name for it, by the name of the file."""
    return re.sub(r"^specification(?=:)", lambda _: file, words, flags=re.MULTILINE)


@command(
    "export",
    "write transformations as a specification file",
    "Write transformations as one specification, which 'import' reads.",
    "dyknow export > library.xml\ndyknow export 'undistort(cam1)' relay -o some.xml",
    _labels("*", "what to export (default: all)"),
    argument("-o --output", "FILE", "write here (default: print)"),
)
def _export(arguments: argparse.Namespace, shell: Shell) -> None:
    chosen = _chosen(shell, arguments.labels)
    text = specification_text(chosen)
    labels = [each.label for each in chosen]
    if arguments.output:
        write_file(arguments.output, text.encode("utf-8"))
        shell.show(
            {"file": arguments.output, "labels": labels},
            [f"wrote {count(len(chosen), 'transformation')} to {arguments.output}"],
        )
    else:
        shell.show({"labels": labels, "specification": text}, [text.rstrip("\n")])


def specification_text(transformations: Iterable[Transformation]) -> str:
    """Write transformations as one specification."""
    inside = "".join(each.to_xml() for each in transformations)
    return f"<transformations>\n{inside}</transformations>\n"


@command(
    "remove",
    "remove transformations",
    "Remove transformations from the library. Nodelets that were made from them run on.",
    "dyknow remove 'undistort(cam1)'",
    _labels("+", "what to remove; nodelets made from it run on"),
)
def _remove(arguments: argparse.Namespace, shell: Shell) -> int | None:
    return shell.for_each("label", "removed", arguments.labels, shell.client.remove_transformation)


@command(
    "check",
    "check specification files without a manager",
    "Find all problems of specification files, with file and line, without a manager or a "
    "master. The exit code is 1 if there are problems; warnings are none: nodelet types, "
    "programs and message types, for instance, that this machine does not have.",
    "dyknow check cameras.xml\ndyknow check --ontology soccer.owl *.xml",
    _FILES,
    argument(
        "--ontology",
        "OWL",
        "file in which templates find the individuals of a concept; may be repeated",
        action="append",
        default=[],
    ),
    argument(
        "--catalogue",
        "XML",
        "XML catalogue of the ontologies that these import; may be repeated",
        action="append",
        default=[],
    ),
    argument(
        "--language",
        "CODE",
        "language of the labels that are preferred as names (default: %(default)s)",
        default="en",
    ),
)
def _check(arguments: argparse.Namespace, shell: Shell) -> int | None:
    ontology = _ontology(arguments)
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


def _ontology(arguments: argparse.Namespace) -> Ontology | None:
    if not arguments.ontology:
        return None
    from dyknow.manager.specifications.ontology import load_ontology

    return load_ontology(
        arguments.ontology, language=arguments.language, catalogues=arguments.catalogue
    )


def _report(
    file: str, ontology: Ontology | None
) -> tuple[Sequence[str], Sequence[Problem], Sequence[Problem]]:
    from dyknow.errors import SpecificationError
    from dyknow.manager.specifications.specification import parse, parse_file
    from dyknow.ros.formulas.message_types import message_type
    from dyknow.ros.hosting.installed import missing_here

    try:
        if file == STDIN:
            text = sys.stdin.buffer.read()
            found = parse(text, "standard input", ontology, types=message_type)
        else:
            found = parse_file(file, ontology, types=message_type)
    except SpecificationError as error:
        return (), error.problems, error.warnings
    missing = missing_here(file, found.transformations)
    return [each.label for each in found.transformations], (), (*found.warnings, *missing)


def _with_warning(problem: Problem) -> str:
    return str(problem._replace(message=f"warning: {problem.message}"))
