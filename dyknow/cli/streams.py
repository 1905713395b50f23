# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The arguments of a request for a stream."""

from __future__ import annotations

import argparse
import os
import socket

from dyknow.cli import completion
from dyknow.cli.arguments import hertz, seconds
from dyknow.model.streams import StreamRequest


def demand_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    completion.complete_with(
        parser.add_argument(
            "tag", metavar="TAG", help="the tag of the stream, such as 'FieldPosition(ball)'"
        ),
        completion.tags,
    )
    parser.add_argument(
        "--datatype",
        metavar="TYPE",
        default="",
        help="the ROS type of the stream, such as geometry_msgs/PointStamped (default: any)",
    )
    completion.complete_with(
        parser.add_argument(
            "--exclude",
            metavar="LABEL",
            nargs="+",
            action="extend",
            default=[],
            help="transformations that must not be used",
        ),
        completion.labels,
    )

    parser.add_argument(
        "--min-rate",
        metavar="HZ",
        type=hertz,
        default=0.0,
        help="how many messages a second there have to be (default: any number)",
    )
    parser.add_argument(
        "--max-age",
        metavar="SECONDS",
        type=seconds,
        default=0.0,
        help="how old messages may be when they are sent, by their headers' stamps (default: any "
        "age)",
    )
    for option, what in (
        ("--prefer", "use these where there is a choice"),
        ("--avoid", "use these only where there is no choice"),
    ):
        completion.complete_with(
            parser.add_argument(
                option,
                metavar="NAME",
                nargs="+",
                action="extend",
                default=[],
                help=f"{what}: transformations by label, or concepts of their tags",
            ),
            completion.labels,
        )
    parser.add_argument(
        "--budget",
        metavar="SECONDS",
        type=seconds,
        default=0.0,
        help="how long the plan may be improved (default: 0.1 s)",
    )


def request_of(
    arguments: argparse.Namespace, lease: float = 0.0, max_silence: float = 0.0
) -> StreamRequest:
    """Make the request from the arguments; the client is this process."""
    return StreamRequest(
        tag=arguments.tag,
        datatype=arguments.datatype,
        client_id=f"dyknow acquire on {socket.gethostname()} ({os.getpid()})",
        lease=lease,
        max_silence=max_silence,
        exclude=tuple(arguments.exclude),
        min_rate=arguments.min_rate,
        max_age=arguments.max_age,
        prefer=tuple(arguments.prefer),
        avoid=tuple(arguments.avoid),
        budget=arguments.budget,
    )
