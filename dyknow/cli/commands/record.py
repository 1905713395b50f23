# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`record` and `why`: the last seconds of streams, from nodelets dyknow/BlackBox."""

from __future__ import annotations

import argparse
import json
import os
import time

from dyknow.cli import completion
from dyknow.cli.arguments import argument
from dyknow.cli.commands.nodelets import show_spawned
from dyknow.cli.output import columns
from dyknow.cli.shell import Acted, Shell, command
from dyknow.errors import DyKnowError, NodeletUnreachable
from dyknow.model.transformation import Parameter

#: What a black box is made from, unless the library has another transformation of that label.
_LABEL = "black box"
_SPECIFICATION = f"""\
<transformation>
  <label>{_LABEL}</label>
  <source>dyknow/BlackBox</source>
  <params>
    <param name="topics" type="yaml">[]</param>
    <param name="manager" type="string">dyknow_manager</param>
  </params>
</transformation>
"""


@command(
    "Let black boxes write what they keep: the last seconds of their topics, and of the events "
    "and the model of the manager. Each writes a bag on its host. With --black-box start one.",
    "dyknow record --black-box\ndyknow record --black-box '/camera/*' /odom\n"
    "dyknow record\ndyknow record black_box",
    argument("names", "NAME", "black boxes (default: all of the manager)", nargs="*"),
    argument(
        "--black-box",
        "TOPIC",
        "start a black box, the nodelet black_box, for these topics, names or patterns, besides "
        "the events, verdicts and model of the manager, which all keep",
        nargs="*",
        completer=completion.topics,
    ),
)
def _record(arguments: argparse.Namespace, shell: Shell) -> int | None:
    if arguments.black_box is not None:
        if arguments.names:
            arguments.refuse("--black-box starts one called black_box; expected it without names")
        _start(arguments.black_box, shell)
        return None
    names = [shell.resolve(name) for name in arguments.names] or _boxes(shell)

    def write(name: str) -> Acted:
        try:
            bag = shell.client.write_bag(name)
        except NodeletUnreachable as error:
            known = shell.client.black_boxes()
            if name in known:
                raise
            listed = ", ".join(known) or "none"
            raise DyKnowError(
                f"'{name}' is no black box; those of the manager: {listed}"
            ) from error
        return [bag], [f"wrote {bag}"]

    return shell.for_each("nodelet", "wrote", names, write)


@command(
    "Tell what happened to a claim, with the values that decided: its changes, verdicts, and the "
    "nodelets that it used. The story comes from a black box, which writes a bag for it, or from "
    "a bag that one wrote before.",
    "dyknow why\ndyknow why 3f0c1a2b4d5e\n"
    "dyknow why 3f0c1a2b4d5e --bag ~/.ros/black_box/black_box_2026-11-26-10-15-00.bag",
    argument("claim", "ID", "a claim; see 'streams' (default: all claims)", nargs="?", default=""),
    argument("--bag", "FILE", "a bag that a black box wrote"),
)
def _why(arguments: argparse.Namespace, shell: Shell) -> None:
    from dyknow.ros.shell.story import moments  # rosbag takes its time to import

    path = arguments.bag or shell.client.write_bag(_boxes(shell)[0])
    if not (arguments.bag or os.path.exists(path)):
        raise DyKnowError(
            f"{path} is on the host of the black box: run 'dyknow why' there, or copy it for --bag"
        )
    found = moments(path, arguments.claim)
    rows = [(_clock(each.when), each.subject, each.what) for each in found]
    value = {"bag": path, "moments": [each._asdict() for each in found]}
    shell.show(value, [*columns(rows), f"from {path}"])


def _start(topics: list[str], shell: Shell) -> None:
    """Spawn a black box that keeps these topics."""
    name = shell.resolve("black_box")
    if shell.client.get_graph().nodelet(name) is not None:
        raise DyKnowError(f"'{name}' runs already; end it first: dyknow destroy {name}")
    if all(each.label != _LABEL for each in shell.client.get_model().transformations):
        shell.client.add_transformation(_SPECIFICATION)
    given = [
        Parameter("topics", "", json.dumps(topics)),
        Parameter("manager", "", shell.client.manager),
    ]
    shell.client.spawn(_LABEL, name, parameters=given)
    show_spawned(shell, name)


def _boxes(shell: Shell) -> list[str]:
    found = shell.client.black_boxes()
    if not found:
        raise DyKnowError("no black box runs; start one: dyknow record --black-box '/camera/*'")
    return found


def _clock(when: float) -> str:
    when = round(when, 3)
    return time.strftime("%H:%M:%S", time.localtime(when)) + f"{when % 1:.3f}"[1:]
