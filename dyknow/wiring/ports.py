"""Short looks at ports: what they are connected to, and which fit together."""

from __future__ import annotations

from typing import TYPE_CHECKING, Dict, Iterable, List

if TYPE_CHECKING:
    from dyknow.manager.model import PortState
    from dyknow.ros.views import NodeletView

#: The type of ports that take any.
ANY = "*"


def by_name(ports: Iterable[PortState]) -> List[PortState]:
    """Sort ports: the manager shows them in the order in which the nodelet made them."""
    return sorted(ports, key=lambda port: port.name)


def connections_of(nodelet: NodeletView) -> Dict[str, str]:
    """Topics of the ports that are connected, by port."""
    return {port.name: port.topic for port in by_name(nodelet.ports) if port.topic}


def types_fit(one: str, other: str) -> bool:
    """Whether streams of two types may be connected; an unknown type fits every one."""
    return one == other or not one or not other or ANY in (one, other)
