# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Launch files as roslaunch finds and reads them; what is wrong with one is said with its line."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any, List, Sequence, Tuple
from xml.parsers import expat

import roslaunch.config
import rospkg
from roslaunch.core import RLException
from roslaunch.loader import LoadException
from roslaunch.rlutil import resolve_launch_arguments
from roslaunch.xmlloader import XmlLoader

from dyknow.errors import CannotLaunch
from dyknow.similar import did_you_mean

STDIN = "-"
#: What roslaunch raises about a launch file.
ERRORS = (RLException, LoadException, rospkg.ResourceNotFound, ValueError)
#: A launch file, and the arguments that it is given, as roslaunch takes them.
Source = Tuple[str, Sequence[str]]


def find_files(words: Sequence[str]) -> List[str]:
    """Find launch files: `PKG FILE ...` or `FILE ...`.

    Raises:
        CannotLaunch: there is no such package or file.
    """
    try:
        files = [str(each) for each in resolve_launch_arguments(list(words))]
    except RLException as error:
        raise CannotLaunch(_not_found(words)) from error
    for file in files:
        if file != STDIN and not os.path.isfile(file):
            raise CannotLaunch(f"there is no launch file '{file}'")
    return files


def launch_files(package: str) -> List[str]:
    """Return the names of a package's launch files, sorted; empty if there is no such package."""
    try:
        folder = Path(rospkg.RosPack().get_path(package))
    except rospkg.ResourceNotFound:
        return []
    return sorted({file.name for file in folder.rglob("*.launch")})


def arguments_of(file: str) -> List[str]:
    """Return the names of the arguments that a launch file can be given, sorted."""
    elements = re.findall(r"<arg\s[^>]*>", _text(file))
    settable = (each for each in elements if not re.search(r"\svalue\s*=", each))
    found = (re.search(r"\sname\s*=\s*[\"']([^\"']+)", each) for each in settable)
    return sorted({match.group(1) for match in found if match})


def unknown_arguments(
    files: Sequence[str], loaded: Sequence[str], given: Sequence[str]
) -> List[str]:
    """Say which arguments were given that no launch file speaks of; roslaunch ignores those.

    Args:
        files: the launch files that were asked for.
        loaded: those, and all that they include.
        given: `NAME:=VALUE`.
    """
    spoken_of = set(re.findall(r"\w+", " ".join(map(_text, loaded))))
    declared = {name for file in files for name in arguments_of(file)}
    return [
        f"no launch file has an argument '{name}'{did_you_mean(name, declared)}"
        for name in (each.partition(":=")[0] for each in given)
        if not name.startswith("_") and name not in spoken_of
    ]


def explain(sources: Sequence[Source], error: BaseException) -> str:
    """Say in one line why launch files cannot be read, with file and line where it can be told.

    Args:
        sources: the launch files. They are read again.
        error: what roslaunch raised.
    """
    text = re.sub(r"while processing [^\n]*:\n", "", str(error))
    if isinstance(error, rospkg.ResourceNotFound):
        text = f"there is no package '{error.args[0]}' on ROS_PACKAGE_PATH"
    text = one_line(text)
    loader = _Locator()
    try:
        roslaunch.config.load_config_default(sources, None, loader=loader, assign_machines=False)
    except ERRORS:
        return f"{loader.place}: {text}" if loader.place else text
    return text


def one_line(error: object) -> str:
    """Write a message of roslaunch in one line."""
    return " ".join(str(error).split())


class _Locator(XmlLoader):  # type: ignore[misc]
    """Reads launch files as roslaunch does, and knows where it is.

    Attributes:
        place: `FILE` or `FILE:LINE` of the element that is read; empty before the first.
    """

    def __init__(self) -> None:
        super().__init__()
        self.place = ""
        self._found = False

    def _parse_launch(self, filename: str, verbose: bool) -> Any:
        self.place = filename  # all that is known of one that is no XML
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
        except LoadException as error:
            if str(error).startswith("unused args"):  # found when the included file was read
                self._come_to(tag, context)
            self._found = True
            raise

    def _come_to(self, tag: Any, context: Any) -> None:
        if not self._found and hasattr(context, "filename"):  # of <launch> itself it is another
            self.place = f"{context.filename}:{tag.getUserData('line')}"


def _lines(file: str) -> List[int]:
    """Return the lines of a file's elements, in their order."""
    lines: List[int] = []
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
