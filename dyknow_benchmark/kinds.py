# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The kinds of chains that are compared."""

from __future__ import annotations

from typing import Dict, Sequence

#: What each kind is, in the order in which it is shown.
KINDS: Dict[str, str] = {
    "dyknow": "DyKnow nodelets: ports, through the proxy",
    "nodelet": "plain Python nodelets of the same nodelet manager: topics, no proxy",
    "function": "Python functions that call each other",
    "rospy": "publishers and subscribers within one rospy process",
    "node": "rospy nodes, a process each",
    "script": "the same rospy nodes, unchanged, as scripts in DyKnow's nodelet manager",
    "cpp_nodelet": "C++ nodelets in the stock nodelet manager",
    "cpp_live": "the same C++ nodelets with live ports, in DyKnow's nodelet manager",
    "cpp_node": "C++ nodes, a process each",
}

#: The kinds of the paper's figure, with function calls (the floor) and C++ beside them.
THE_PAPERS: Sequence[str] = tuple(
    kind for kind in KINDS if kind not in ("rospy", "script", "cpp_live")
)

#: What the figure calls them.
LABELS: Dict[str, str] = {
    "dyknow": "DyKnow nodelets",
    "nodelet": "Python nodelets without proxy",
    "function": "function calls",
    "rospy": "one rospy process",
    "node": "rospy nodes",
    "script": "scripts as nodelets",
    "cpp_nodelet": "C++ nodelets",
    "cpp_live": "C++ nodelets with live ports",
    "cpp_node": "C++ nodes",
}
