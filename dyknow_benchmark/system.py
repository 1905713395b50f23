# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A DyKnow manager as a process, for the measurements at scale."""

from __future__ import annotations

import statistics
import xmlrpc.client
from typing import Any, Iterable, List, Tuple
from xml.sax.saxutils import escape

import rosgraph
import rospy
from dyknow_msgs.srv import GetModel

from dyknow.ros.client import ManagerClient
from dyknow_benchmark.session import Session, executable

#: Where the manager's own nodelet manager is.
NODELET_MANAGER = "/dyknow_nodelet_manager"
MANAGER = "/dyknow_manager"

RELAYS = """
<transformations>
  <transformation><label>source</label><source>dyknow/Source</source>
    <params><param name="rate" type="double">50</param></params>
    <ports><port type="out">out</port></ports></transformation>
  <transformation><label>relay</label><source>dyknow/Relay</source>
    <ports><port type="in">in</port><port type="out">out</port></ports></transformation>
</transformations>
"""


def start(session: Session) -> ManagerClient:
    """Start a manager with the shipped source and relay in its library."""
    start_manager(session)
    rospy.wait_for_service(f"{MANAGER}/get_model", 60.0)
    client = ManagerClient(MANAGER)
    client.add_transformation(RELAYS)
    return client


def start_manager(session: Session) -> None:
    """Start the process of a manager, which goes on where one that was killed ended."""
    # Its nodelet managers end soon after it, even if it is killed.
    session.start([executable("dyknow", "manager"), "_orphan_timeout:=2"])


def model_service() -> rospy.ServiceProxy:
    """Call get_model over one connection, without turning the answer into values."""
    return rospy.ServiceProxy(f"{MANAGER}/get_model", GetModel, persistent=True)


def library_text(count: int) -> str:
    """Write a specification of ``count`` transformations in layers, each with parameters."""
    width = max(1, count // 20)
    parts: List[str] = ["<transformations>"]
    for number in range(count):
        layer, place = divmod(number, width)
        needs = [(place * 7 + k * 13 + number) % width for k in range(number % 3 + 1)]
        ports = "".join(f'<port type="in">in{k}</port>' for k in range(len(needs) if layer else 0))
        tags = "".join(
            f'<tag port="in{k}">Stream{layer - 1}(x{each})</tag>'
            for k, each in enumerate(needs if layer else ())
        )
        parts.append(
            f'<transformation cost="{number % 19 + 1}"><label>{escape(f"t{number}")}</label>'
            "<source>dyknow/Relay</source>"
            f'<params><param name="rate" type="double">{number % 50 + 1}</param></params>'
            f'<ports>{ports}<port type="out" datatype="std_msgs/Header">out</port></ports>'
            f'<tags>{tags}<tag port="out">Stream{layer}(x{place})</tag></tags></transformation>'
        )
    parts.append("</transformations>")
    return "\n".join(parts)


def pid(node: str) -> int:
    """Ask a node for its process id."""
    uri = rosgraph.Master(rospy.get_name()).lookupNode(node)
    answer: Any = xmlrpc.client.ServerProxy(uri).getPid(rospy.get_name())
    return int(answer[2])


def spread(values: Iterable[float]) -> Tuple[float, float, float]:
    """Minimum, median and maximum."""
    ordered = sorted(values)
    return ordered[0], statistics.median(ordered), ordered[-1]
