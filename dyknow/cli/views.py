"""Short looks at a nodelet as the manager shows it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Dict

if TYPE_CHECKING:
    from dyknow.ros.client import NodeletView


def state_of(nodelet: NodeletView) -> str:
    """Its state in a word: `starting`, `running`, `lost` or `failed`."""
    return nodelet.state.name.lower()


def connections_of(nodelet: NodeletView) -> Dict[str, str]:
    """Topics of the ports that are connected."""
    return {port.name: port.topic for port in nodelet.ports if port.topic}
