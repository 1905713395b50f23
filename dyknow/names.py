# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""ROS graph names: validity, namespaces, resolution and remapping.

The rules are those of http://wiki.ros.org/Names, in the order in which roscpp's NodeHandle
applies them: a name is first made global, then looked up in the remappings.
"""

from __future__ import annotations

import hashlib
import itertools
import re
from typing import Callable, Sequence

from dyknow.errors import BadRemapping, InvalidName

#: Forms in which image_transport sends messages on topics below those of the messages themselves.
FORMS = ("compressed",)
#: The parameter that each node of rospy and roscpp subscribes to when it logs, to its end.
LOG_PARAMETER = "/rosout_disable_topics_generation"

_LEGAL = re.compile(r"[~/A-Za-z][A-Za-z0-9_/]*\Z")


def check(name: str, what: str = "name") -> str:
    """Return a legal graph name in its usual form: ``~/x`` is ``~x``, as roscpp resolves it."""
    legal = isinstance(name, str) and _LEGAL.match(name) and "//" not in name
    if not legal or name in ("~", "/", "~/"):
        raise InvalidName(name, what)
    return name.rstrip("/").replace("~/", "~", 1)


def join(namespace: str, name: str) -> str:
    """Append a relative ``name`` to a ``namespace`` (``/`` for the root)."""
    return namespace.rstrip("/") + "/" + name.lstrip("/")


def parent(name: str) -> str:
    """Namespace of a global name: ``/robot`` for ``/robot/camera``, ``/`` at the root."""
    return name.rstrip("/").rpartition("/")[0] or "/"


def resolve(name: str, namespace: str, private: str, what: str = "name") -> str:
    """Make ``name`` global without remapping it; empty stands for the namespace itself."""
    return complete(check(name, what), namespace, private) if name else namespace


def complete(name: str, namespace: str, private: str) -> str:
    """Make a name global without checking its characters, as rospy does for parameters.

    Of a name that is a namespace (``""``, ``~``, ``/``) the result ends with a slash.
    """
    if name.startswith("~"):
        name, namespace = name[1:], private
    elif name.startswith("/"):
        namespace = "/"
    whole = "/" + "/".join(filter(None, f"{namespace}/{name}".split("/")))
    return whole if name.strip("/") else join(whole, "")


def as_in_rospy(name: str) -> str:
    """Make ``/x`` of ``~/x``, which rospy takes for a global name."""
    return name[1:] if name.startswith("~/") and name.strip("~/") else name


def disconnected(node: str, port: str) -> str:
    """The topic that a port is remapped to so that it starts disconnected.

    Re-wirable nodes treat it as none, and nothing else uses it.
    """
    return join(node, "disconnected/" + port.lstrip("~/"))


def topic_after(nodelet: str, port: str) -> str:
    """Name a topic after a port of a nodelet."""
    return join(nodelet, port.lstrip("~/"))


def below(topic: str, form: str) -> str:
    """Topic of another form of a topic's messages; empty without a topic."""
    return f"{topic}/{form}" if topic else ""


def free_topic(nodelet: str, port: str, is_taken: Callable[[str], bool]) -> str:
    """Name a topic after a port of a nodelet, with a number at its end if that name is taken."""
    after = topic = topic_after(nodelet, port)
    for number in itertools.count(2):
        if not is_taken(topic):
            break
        topic = f"{after}_{number}"
    return topic


def mark(name: str) -> int:
    """Hash a name to 64 bits: an even number above 0.

    Among a hundred thousand names, two share a hash with a probability of 1 in 10^9. The bits are
    never those of a double that is not a number, since they are stored as one.
    """
    digest = hashlib.blake2b(name.encode(), digest_size=8).digest()
    return (int.from_bytes(digest, "big") | 2) & ~1 & ~(1 << 62)


def pair_remappings(
    nodelet: str, sources: Sequence[str], targets: Sequence[str], namespace: str
) -> dict[str, str]:
    """Turn the two lists of a load request into a table of global names.

    Relative names begin in ``namespace`` (the manager's, as in the C++ manager); a ``~`` stands
    for the nodelet itself, while the C++ manager silently ignores it.

    Raises:
        BadRemapping: the lists differ in length.
        InvalidName: an entry is empty or not a graph name.
    """
    if len(sources) != len(targets):
        raise BadRemapping(nodelet, len(sources), len(targets))

    def whole(name: str, what: str) -> str:
        return resolve(check(name, what), namespace, nodelet, what)

    return {
        whole(source, "remap source"): whole(target, "remap target")
        for source, target in zip(sources, targets)
    }
