# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How DyKnow managers hand their guards to nodelet managers: private parameters of these.

Each DyKnow manager has a parameter of its own, ``~guards/KEY``, and the guards of all add up:
none lifts what another denies, and each takes away only its own. With them go the names of
the nodelets that the owner protects from being unloaded by other nodes. The parameter server
notifies a nodelet manager of every change, so a check costs no remote call and guards that change
reach running nodelets.
"""

from __future__ import annotations

from typing import Any, Iterable, Sequence

import rospy
from rospy.impl.paramserver import ParamServerCache, get_param_server_cache

from dyknow.errors import Denied, PeerTimeout, ProtectedFromUnloading
from dyknow.guards import NO_GUARDS, Guards, together
from dyknow.ros.wire.master import Master

#: Environment variable of programs that a DyKnow manager starts: its guards bind them from their
#: start. What people launch begins where they say, and is bound when it is connected elsewhere.
SPAWNED = "DYKNOW_SPAWNED"
_GUARDS = "guards"
_PROTECTED = "protected"


def guards_key(owner: str) -> str:
    """Relative name of the parameter in which a DyKnow manager, a node, hands over its guards."""
    return f"{_GUARDS}/{_key_of(owner)}"


def _key_of(owner: str) -> str:
    # Two owners never share a key, nor does one key begin another: that would nest them.
    return owner.strip("/").replace("_", "__").replace("/", "_s")


def to_parameter(guards: Guards, protected: Sequence[str] = ()) -> dict[str, Any]:
    """Write guards, and the names of protected nodelets, as a value of the parameter server."""
    return {
        "denied_topics": list(guards.denied_topics),
        "allowed_topics": [list(each) for each in guards.allowed_topics],
        "allowed_programs": [list(each) for each in guards.allowed_programs],
        "remote_programs": guards.remote_programs,
        "read_only": guards.read_only,
        "string_length": guards.string_length,
        "array_length": guards.array_length,
        _PROTECTED: list(protected),
    }


def from_parameter(value: Any) -> Guards:
    """Read a value of ``to_parameter``; missing entries guard nothing."""
    if not isinstance(value, dict):
        return NO_GUARDS
    return Guards(
        denied_topics=tuple(map(str, value.get("denied_topics", ()))),
        allowed_topics=_lists(value.get("allowed_topics", ())),
        allowed_programs=_lists(value.get("allowed_programs", ())),
        remote_programs=bool(value.get("remote_programs", True)),
        read_only=bool(value.get("read_only", False)),
        string_length=int(value.get("string_length", NO_GUARDS.string_length)),
        array_length=int(value.get("array_length", NO_GUARDS.array_length)),
    )


def _lists(value: Iterable[Iterable[Any]]) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(map(str, each)) for each in value)


class GuardParameters:
    """The guards of this process, whose node must be initialised."""

    def __init__(self) -> None:
        self._name: str = rospy.resolve_name("~" + _GUARDS)
        self._master = Master(rospy.get_name())
        self._values = ParamServerCache()
        _keep_apart(self._name, self._values)
        address = rospy.core.get_node_uri()
        self._values.set(self._name, self._master.ask("subscribeParam", address, self._name))

    def current(self) -> Guards:
        """Return the guards of this moment, those of all owners together."""
        return together(map(from_parameter, self._read().values()))

    def check_caller(self, caller: str, what: str) -> None:
        """Raise Denied in read-only mode, unless a read-only DyKnow manager makes the change.

        Such a manager refuses the requests of users, and still restores nodelets that died.
        """
        guards = self._read()
        own = from_parameter(guards.get(_key_of(caller)))
        if not own.read_only:
            together(map(from_parameter, guards.values())).check_writable(what)

    def check_program(self, caller: str, program: str) -> None:
        """Raise Denied for a script; a DyKnow manager has checked its own guards."""
        if program.startswith("/"):
            raise Denied(f"script '{program}'", "expected PACKAGE/SCRIPT, not a path")
        own = _key_of(caller)
        others = (from_parameter(each) for key, each in self._read().items() if key != own)
        together(others).check_program(program)

    def check_protection(self, caller: str, name: str) -> None:
        """Raise ProtectedFromUnloading if another DyKnow manager than the caller protects it.

        The parameter server itself is queried: its notification may still be on the way when a
        protection has been acknowledged.
        """
        own = _key_of(caller)
        try:
            guards = _by_owner(self._master.ask("getParam", self._name))
        except LookupError:
            return
        except PeerTimeout:
            guards = self._read()
        for key, each in guards.items():
            if key != own and name in each.get(_PROTECTED, ()):
                raise ProtectedFromUnloading(name)

    def _read(self) -> dict[str, Any]:
        try:
            return _by_owner(self._values.get(self._name))
        except KeyError:  # it is not set
            return {}


def _by_owner(value: Any) -> dict[str, Any]:
    parameters = value.items() if isinstance(value, dict) else ()
    return {key: guards for key, guards in parameters if isinstance(guards, dict) and guards}


def _keep_apart(name: str, values: ParamServerCache) -> None:
    """Let rospy put notifications of parameters at and below ``name`` into a cache of ours.

    Its own cache refuses those of a parameter that it does not have yet. If it had ours, it would
    answer ``get_param("~")`` with them alone.
    """
    cache = get_param_server_cache()
    update_others = cache.update

    def update(key: str, value: Any) -> None:
        (values.set if f"{key}/".startswith(f"{name}/") else update_others)(key, value)

    cache.update = update


def caller_of(request: Any) -> str:
    """Name of the node that made a request to a service."""
    return str((getattr(request, "_connection_header", None) or {}).get("callerid", ""))
