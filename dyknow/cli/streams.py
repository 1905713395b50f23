"""How the command line asks for a stream."""

from __future__ import annotations

import argparse
import os
import socket

from dyknow.cli import completion
from dyknow.model.streams import StreamRequest


def demand_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what is asked for."""
    completion.complete_with(
        parser.add_argument(
            "tag", metavar="TAG", help="what it is about, such as 'FieldPosition(ball)'"
        ),
        completion.tags,
    )
    parser.add_argument(
        "--datatype",
        metavar="TYPE",
        default="",
        help="the ROS type that it must have, such as geometry_msgs/PointStamped (default: any)",
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


def request_of(
    arguments: argparse.Namespace, lease: float = 0.0, max_silence: float = 0.0
) -> StreamRequest:
    """Make the request that the arguments ask for, in the name of this shell."""
    return StreamRequest(
        tag=arguments.tag,
        datatype=arguments.datatype,
        client_id=f"dyknow acquire on {socket.gethostname()} ({os.getpid()})",
        lease=lease,
        max_silence=max_silence,
        exclude=tuple(arguments.exclude),
    )
