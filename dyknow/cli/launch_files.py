# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Launch files as roslaunch finds and reads them, and the lines of their errors."""

from __future__ import annotations

import contextlib
import os
import re
from pathlib import Path
from typing import Any, Sequence, Tuple
from xml.parsers import expat

import roslaunch.config
import rospkg
from roslaunch.core import RLException
from roslaunch.loader import LoadException
from roslaunch.rlutil import resolve_launch_arguments
from roslaunch.xmlloader import XmlLoader

from dyknow.cli.output import STDIO
from dyknow.errors import CannotLaunch
from dyknow.similar import did_you_mean

#: What roslaunch raises about a launch file.
ERRORS = (RLException, LoadException, rospkg.ResourceNotFound, ValueError)
#: A launch file, and the arguments that it is given, as roslaunch takes them.
Source = Tuple[str, Sequence[str]]


def find_files(words: Sequence[str]) -> list[str]:
    """Find launch files: `PKG FILE ...` or `FILE ...`.

    Raises:
        CannotLaunch: the package or file does not exist, or the package has several of that name.
    """
    try:
        files = [str(each) for each in resolve_launch_arguments(list(words))]
    except RLException as error:
        text = one_line(error)
        is_ambiguous = text.startswith("multiple files")
        raise CannotLaunch(text if is_ambiguous else _not_found(words)) from error
    for file in files:
        if file != STDIO and not os.path.isfile(file):
            raise CannotLaunch(f"there is no launch file '{file}'")
    return files


def launch_files(package: str) -> list[str]:
    """Return the names of a package's launch files, sorted; empty if the package is unknown."""
    try:
        folder = rospkg.RosPack().get_path(package)
    except rospkg.ResourceNotFound:
        return []
    found: set[str] = set()
    seen: set[str] = set()
    for here, below, files in os.walk(folder, followlinks=True):
        place = os.path.realpath(here)
        # roslaunch passes hidden folders over too; links may lead in circles.
        below[:] = [each for each in below if each[:1] != "." and place not in seen]
        seen.add(place)
        found.update(each for each in files if each.endswith(".launch"))
    return sorted(found)


def arguments_of(file: str) -> list[str]:
    """Return the names of the arguments that a launch file can be given, sorted."""
    return _arguments_in(_text(file))


def _arguments_in(text: str) -> list[str]:
    elements = re.findall(r"<arg\s[^<>]*>", text)
    settable = (each for each in elements if not re.search(r"\svalue\s*=", each))
    found = (re.search(r"\sname\s*=\s*[\"']([^\"']+)", each) for each in settable)
    return sorted({match.group(1) for match in found if match})


def unknown_arguments(
    files: Sequence[str], loaded: Sequence[str], given: Sequence[str], piped: str = ""
) -> list[str]:
    """Say which of the given `NAME:=VALUE` no launch file speaks of; roslaunch ignores those.

    The user has named ``files``; ``loaded`` are those and all that they include, and ``piped`` is
    the launch file on standard input.
    """
    spoken_of = set(re.findall(r"\w+", " ".join([piped, *map(_text, loaded)])))
    declared = {name for text in (piped, *map(_text, files)) for name in _arguments_in(text)}
    return [
        f"no launch file has an argument '{name}'{did_you_mean(name, declared)}"
        for name in (each.partition(":=")[0] for each in given)
        if not name.startswith("_") and name not in spoken_of | declared
    ]


def explain(sources: Sequence[Source], error: BaseException) -> str:
    """Say in one line why launch files cannot be read, with file and line where these are known.

    The files are read again. ``error`` was raised by roslaunch, or by an expression in a file.
    """
    text = said(error)
    loader = _read_again(sources)
    place = loader.place if loader.has_failed else loader.place_of(text)
    return f"{place}: {text}" if place else text


def said(error: BaseException) -> str:
    """Say in one line why roslaunch does not go on, without the place."""
    return one_line(_message(error))


def place_of_node(sources: Sequence[Source], node: Any) -> str:
    """Return `FILE:LINE` of one of roslaunch's nodes, or as much of that as is known.

    The files are read again.
    """
    return _read_again(sources).nodes.get((node.filename, node.name), str(node.filename))


def _read_again(sources: Sequence[Source]) -> _Locator:
    loader = _Locator()
    try:
        roslaunch.config.load_config_default(sources, None, loader=loader, assign_machines=False)
    except Exception:  # the boundary: the error is known
        loader.has_failed = True
    return loader


def _message(error: BaseException) -> str:
    if isinstance(error, rospkg.ResourceNotFound):
        return f"there is no package '{error.args[0]}' on ROS_PACKAGE_PATH"
    if isinstance(error, KeyError):  # roslaunch takes an attribute for granted
        return f"attribute {error} is missing"
    if isinstance(error, OSError):
        return f"{error.strerror}: '{error.filename}'"
    text = re.sub(r"while processing [^\n]*:\n", "", str(error))
    text = re.sub(r"(?s)\ALaunch string: .*\nException: ", "standard input: ", text)
    text = re.sub(r"Invalid roslaunch XML syntax: \[Errno \d+\] ", "", text)
    if "maximum recursion depth exceeded" in text:
        return "the launch files include each other without end"
    return text if isinstance(error, ERRORS) else f"{type(error).__name__}: {text}"


def one_line(error: object) -> str:
    """Write a message of roslaunch in one line."""
    return " ".join(str(error).split())


class _Locator(XmlLoader):  # type: ignore[misc]
    """Reads launch files as roslaunch does, and knows where it is."""

    def __init__(self) -> None:
        super().__init__()
        self.place = ""  # `FILE`, or `FILE:LINE` of the element that is read
        self.nodes: dict[tuple[str, str], str] = {}  # such places, by file and name
        self.has_failed = False  # whether reading failed at that place
        self._machines: dict[str, str] = {}  # places, by names and addresses of machines
        self._found = False

    def place_of(self, text: str) -> str:
        """Return where the machine is named of which an error speaks, in brackets."""
        named = re.search(r"\bmachine \[([^]]*)\]", text)
        return self._machines.get(named.group(1), "") if named else ""

    def _parse_launch(self, filename: str, verbose: bool) -> Any:
        if os.path.isfile(filename):  # else the place is in the file that includes it
            self.place = filename  # the only place in a file that is not XML
            with contextlib.suppress(expat.ExpatError):
                self.place = f"{filename}:{_lines(filename)[0]}"
        launch = super()._parse_launch(filename, verbose)
        root = launch.ownerDocument.documentElement
        for element, line in zip([root, *root.getElementsByTagName("*")], _lines(filename)):
            element.setUserData("line", line, None)
        return launch

    def _check_attrs(self, tag: Any, context: Any, *rest: Any) -> Any:
        self._come_to(tag, context)
        return super()._check_attrs(tag, context, *rest)

    def opt_attrs(self, tag: Any, context: Any, attrs: Any) -> Any:
        self._come_to(tag, context)
        return super().opt_attrs(tag, context, attrs)

    def _include_tag(self, tag: Any, context: Any, *rest: Any) -> Any:
        try:
            return super()._include_tag(tag, context, *rest)
        except Exception as error:
            if str(error).startswith("unused args"):  # found when the included file was read
                self._come_to(tag, context)
            self._found = True
            raise

    def _come_to(self, tag: Any, context: Any) -> None:
        if not self._found and hasattr(context, "filename"):  # of <launch> itself it is another
            self.place = f"{context.filename}:{tag.getUserData('line')}"
            self._note(tag, context)

    def _note(self, tag: Any, context: Any) -> None:
        """Note where nodes and machines are spoken of: errors that come later name them."""

        def value(attribute: str) -> str:
            try:
                return str(self.resolve_args(tag.getAttribute(attribute), context))
            except Exception:  # the boundary: its reader is to find that error
                return ""

        if tag.tagName in ("node", "test"):
            self.nodes.setdefault((context.filename, value("name")), self.place)
            self._machines.setdefault(value("machine"), self.place)
        elif tag.tagName == "machine":
            self._machines[value("address")] = self.place


def _lines(file: str) -> list[int]:
    """Return the lines of a file's elements, in their order."""
    lines: list[int] = []
    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda *_: lines.append(parser.CurrentLineNumber)
    with open(file, "rb") as stream:
        parser.ParseFile(stream)
    return lines


def _text(file: str) -> str:
    return Path(file).read_text(errors="replace") if os.path.isfile(file) else ""


def _not_found(words: Sequence[str]) -> str:
    if len(words) == 1:
        return f"there is no launch file '{words[0]}'; expected PKG FILE, or the path of a file"
    package, file = words[:2]
    packages = rospkg.RosPack().list()
    if package not in packages:
        return (
            f"'{package}' is neither a package on ROS_PACKAGE_PATH nor a launch file"
            f"{did_you_mean(package, packages)}"
        )
    known = launch_files(package)
    return f"package '{package}' has no launch file '{file}'{did_you_mean(file, known)}"
