# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""`record` and `why`: the last seconds of streams, from nodelets dyknow/BlackBox."""

from __future__ import annotations

import argparse
import time

from dyknow.cli.arguments import argument
from dyknow.cli.output import columns
from dyknow.cli.shell import Shell, command
from dyknow.errors import DyKnowError


@command(
    "record",
    "write the last seconds of streams as a bag",
    "Let black boxes write what they keep: the last seconds of their topics, and of the events "
    "and the model of the manager. Each writes a bag on its host.",
    "dyknow record\ndyknow record black_box",
    argument("names", "NAME", "nodelets of type dyknow/BlackBox (default: all)", nargs="*"),
)
def _record(arguments: argparse.Namespace, shell: Shell) -> int | None:
    names = [shell.resolve(name) for name in arguments.names] or _boxes(shell)
    return shell.for_each("nodelet", "wrote", names, shell.client.write_bag)


@command(
    "why",
    "tell what happened to a stream",
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
    found = moments(path, arguments.claim)
    rows = [(_clock(each.when), each.subject, each.what) for each in found]
    value = {"bag": path, "moments": [each._asdict() for each in found]}
    shell.show(value, [*columns(rows), f"from {path}"])


def _boxes(shell: Shell) -> list[str]:
    found = shell.client.black_boxes()
    if not found:
        raise DyKnowError(
            "no black box runs; load one: rosrun dyknow nodelet load dyknow/BlackBox "
            "NODELET_MANAGER __name:=black_box _topics:=\"['/camera/*']\""
        )
    return found


def _clock(when: float) -> str:
    return time.strftime("%H:%M:%S", time.localtime(when)) + f"{when % 1:.3f}"[1:]
