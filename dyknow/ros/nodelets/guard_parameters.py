"""How the DyKnow manager hands its guards to nodelet managers: a private parameter of theirs.

The parameter server tells a nodelet manager of every change, so a check costs no remote call and
guards that change reach nodelets that run.
"""

from __future__ import annotations

from typing import Any, Dict

import rospy
from rospy.impl.paramserver import get_param_server_cache

from dyknow.guards import NO_GUARDS, Guards

#: Relative name of the parameter.
GUARDS = "guards"
_OWNER = "owner"


def to_parameter(guards: Guards, owner: str) -> Dict[str, Any]:
    """Write guards as a value of the parameter server.

    Args:
        guards: the guards.
        owner: node that may make changes in read-only mode: the DyKnow manager, which refuses
            what users ask of it and still brings back nodelets that died.
    """
    return {
        "denied_topics": list(guards.denied_topics),
        "read_only": guards.read_only,
        "string_length": guards.string_length,
        "array_length": guards.array_length,
        _OWNER: owner,
    }


def from_parameter(value: Any) -> Guards:
    """Read what ``to_parameter`` wrote; what is not there is not guarded."""
    if not isinstance(value, dict):
        return NO_GUARDS
    return Guards(
        denied_topics=tuple(str(each) for each in value.get("denied_topics", ())),
        read_only=bool(value.get("read_only", False)),
        string_length=int(value.get("string_length", NO_GUARDS.string_length)),
        array_length=int(value.get("array_length", NO_GUARDS.array_length)),
    )


class GuardParameters:
    """The guards of this nodelet manager."""

    def __init__(self) -> None:
        """Begin to follow the parameter; the node must be initialised."""
        rospy.get_param_cached("~" + GUARDS, {})
        self._name: str = rospy.resolve_name("~" + GUARDS)

    def current(self) -> Guards:
        """Return the guards of this moment."""
        return from_parameter(self._read())

    def check_caller(self, caller: str, what: str) -> None:
        """Refuse a change in read-only mode, unless the DyKnow manager makes it.

        Raises:
            Denied: the mode is read-only.
        """
        value = self._read()
        if not (isinstance(value, dict) and caller and value.get(_OWNER) == caller):
            from_parameter(value).check_writable(what)

    def _read(self) -> Any:
        # Not by get_param_cached: it asks the master again as long as the parameter is not set.
        try:
            return get_param_server_cache().get(self._name)
        except KeyError:
            return {}


def caller_of(request: Any) -> str:
    """Name of the node that made a request to a service."""
    return str((getattr(request, "_connection_header", None) or {}).get("callerid", ""))
