# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The ports of code that knows nothing of ports: the topics that it uses.

A port is called as the code calls its topic, before any remapping; remappings decide where it is
connected at the start. The rules are those of ``src/dyknow_roscpp/port_names.cpp``.
"""

from __future__ import annotations

from typing import Any

from dyknow import names
from dyknow.errors import PortConflict
from dyknow.model.transformation import IN, OUT
from dyknow.nodelet.context import Context, check_message_class
from dyknow.nodelet.handle import PlainNodeHandle
from dyknow.proxy.handle import NodeHandle
from dyknow.proxy.port import InPort, ProxyPort
from dyknow.proxy.proxy import NodeletProxy

#: Topics of the system, which are not ports.
_NO_PORTS = frozenset(("/rosout", "/rosout_agg", "/clock"))


class _Unknown:
    """The type of a port that the script has not made yet."""

    _type, _md5sum = "", "*"


class _PortToCome(InPort):
    """Keeps the topic of a port that its load names, until the script makes it.

    Its direction is not known; a lazy script makes its subscribers late, as a rule.
    """


class ScriptProxy(NodeletProxy):
    """The proxy of a script, whose ports are the topics that it uses."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._by_label: dict[tuple[str, str], ProxyPort] = {}
        #: Labels by the global names that were returned to the script.
        self._noted: dict[str, str] = {}

    def note(self, name: str, resolved: str) -> None:
        """Note the global name of a name: the script may use it for the topic from now on."""
        self._noted[resolved] = self._label(name)

    def _find(self, name: str) -> ProxyPort | None:
        """Find a port by its name, or by the global name that its topic has in the code."""
        found = super()._find(name)
        if found is not None:
            return found
        space = names.parent(self.name)
        origin = names.complete(name, space, self.name)
        same = [p for (label, _), p in self._by_label.items() if self._origin(label) == origin]
        if same:
            return same[0] if len(same) == 1 else None
        label, before = self._label(origin), names.join(space, "")
        label = label[len(before) :] if label.startswith(before) else label
        if origin not in self._context.remappings or self._is_misspelt(label):
            return None
        return self._to_come(origin) or _PortToCome(label, _Unknown, self._start(label))

    def _to_come(self, origin: str) -> _PortToCome | None:
        """Find a port to come; how the script will call its topic is not known."""
        for port in self._ports.values():
            if isinstance(port, _PortToCome) and self._origin(port.name) == origin:
                return port
        return None

    def _is_misspelt(self, label: str) -> bool:
        """Whether a port to come is a port of another namespace that its load does not name.

        A script that watches the subscribers of ``~image`` may subscribe to ``image`` then.
        """
        return any(
            known.lstrip("~/") == label.lstrip("~/")
            and self._origin(known) not in self._context.remappings
            and not port.is_watched
            for (known, _), port in self._by_label.items()
        )

    def _declare(self, kind: Any, handle: PlainNodeHandle, name: str, datatype: Any) -> Any:
        check_message_class(name, datatype)
        label = self._label(names.check(name, "topic name"))
        port = self._by_label.get((label, kind.direction))
        if port is None:
            topic = self._start(label)
            come = self._to_come(self._origin(label))
            if come is not None:
                topic = come.topic
                del self._ports[come.name]
            other = self._by_label.get((label, OUT if kind.direction == IN else IN))
            if other is not None:
                self._rename(other, f"{label}_{other.direction}")
            suffix = f"_{kind.direction}" if other is not None else ""
            port = self._by_label[label, kind.direction] = kind(label + suffix, datatype, topic)
        elif port.datatype._md5sum != datatype._md5sum:
            self._retype(port, datatype)
        return port

    def _retype(self, port: ProxyPort, datatype: Any) -> None:
        """Give a port another type, if the script has let go of it or takes any type there."""
        if not port.handles or (port.direction == IN and port.datatype._md5sum == "*"):
            port.datatype = datatype
        elif port.direction == OUT or datatype._md5sum != "*":
            raise PortConflict(port.name, port.kind, f"a port of type {datatype._type}")

    def _rename(self, port: ProxyPort, name: str) -> None:
        """Tell a port from one of the other direction."""
        renamed = {each.name if each is not port else name: each for each in self._ports.values()}
        port.name = name
        self._ports = renamed

    def _label(self, name: str) -> str:
        if not name.startswith("/"):
            return name
        if name in self._noted:
            return self._noted[name]
        own = names.join(self.name, "")
        return "~" + name[len(own) :] if name.startswith(own) else name

    def _origin(self, label: str) -> str:
        """The global name of a topic in the code, before any remapping."""
        return names.resolve(label, names.parent(self.name), self.name)

    def _start(self, label: str) -> str:
        """The topic that a port is connected to at the start."""
        origin = self._origin(label)
        topic = self._context.remappings.get(origin) or self._context.runtime.node.remap(origin)
        return "" if topic.startswith(names.disconnected(self.name, "")) else topic


class ScriptHandle(NodeHandle):
    """A handle that makes a port of each topic of a script."""

    proxy_class = ScriptProxy
    _proxy: ScriptProxy

    def resolve_name(self, name: str, caller_id: str | None = None) -> str:
        return super().resolve_name(names.as_in_rospy(name), caller_id)

    def tell_name(self, name: str) -> str:
        """Make a name global for the script, which may use that as the name of a topic."""
        resolved = self.resolve_name(name)
        if name.strip("/~") and resolved != name:
            self._proxy.note(names.as_in_rospy(name), resolved)
        return resolved

    def Service(self, name: str, *args: Any, **options: Any) -> Any:  # noqa: N802
        return super().Service(names.as_in_rospy(name), *args, **options)

    def _make_publisher(self, name: str, *args: Any, **options: Any) -> Any:
        name = names.as_in_rospy(name)
        return self._maker(name)._make_publisher(self, name, *args, **options)

    def _make_subscriber(self, name: str, *args: Any, **options: Any) -> Any:
        name = names.as_in_rospy(name)
        return self._maker(name)._make_subscriber(self, name, *args, **options)

    def _maker(self, name: str) -> type[PlainNodeHandle]:
        is_port = self.resolve_name(names.check(name, "topic name")) not in _NO_PORTS
        return NodeHandle if is_port else PlainNodeHandle
