"""Changes of the computation graph as values: each can be made, and most can be taken back.

A change speaks with ``Remote`` and raises what that raises. ``inverse`` is asked with the graph as
it was before the change.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Dict, List, Mapping, Tuple

from dyknow.errors import DyKnowError
from dyknow.model.transformation import Transformation
from dyknow_rqt.graph.snapshot import PortRef, Snapshot

if TYPE_CHECKING:
    from dyknow.model.graph import NodeletStatus
    from dyknow_rqt.remote import Remote

Library = Mapping[str, Transformation]


class CannotUndo(DyKnowError):
    """There is no way back from a change."""


class Change:
    """Something to be done; ``text`` says what, for people."""

    @property
    def text(self) -> str:
        """What is done, in a few words."""
        raise NotImplementedError

    def apply(self, remote: Remote) -> Change:
        """Do it; returns it as it was done, with what was learnt."""
        raise NotImplementedError

    def inverse(self, snapshot: Snapshot, library: Library) -> Change:
        """Return what takes the change back, given how things are before it.

        Raises:
            CannotUndo: there is no way back.
        """
        raise CannotUndo("there is no way back")

    def check(self, remote: Remote) -> None:
        """Ask whether others have changed since what an inverse is to change.

        What the window knows may be older than its own last change.

        Raises:
            CannotUndo: they have.
        """


@dataclass(frozen=True)
class Rewire(Change):
    """Connects ports of any number of nodelets: all of them, or none.

    Attributes:
        topics: by port, what each is to be connected to; empty to disconnect.
        expected: what each has to be connected to for the change to make sense; empty to take
            whatever there is.
        text_: what is done, in a few words.
    """

    topics: Tuple[Tuple[PortRef, str], ...]
    text_: str
    expected: Tuple[Tuple[PortRef, str], ...] = ()

    @property
    def text(self) -> str:
        """What is done."""
        return self.text_

    def apply(self, remote: Remote) -> Change:
        """Connect nodelet by nodelet; if one refuses, bring back those before it."""
        before = dict(self.expected)
        done: List[str] = []
        configs = self._by_nodelet(dict(self.topics))
        try:
            for nodelet, config in configs.items():
                remote.set_config(nodelet, config)
                done.append(nodelet)
        except DyKnowError:
            for nodelet, config in self._by_nodelet(before).items():
                if nodelet in done:
                    remote.set_config(nodelet, config)
            raise
        return self

    def inverse(self, snapshot: Snapshot, library: Library) -> Change:
        """Connect the ports to what they are connected to now."""
        now = []
        for ref, _ in self.topics:
            port = snapshot.port(ref)
            if port is None:
                raise CannotUndo(f"port {ref} is gone")
            now.append((ref, port.topic))
        return Rewire(tuple(now), f"undo: {self.text_}", self.topics)

    def check(self, remote: Remote) -> None:
        """Ask whether the ports are still connected as the change left them."""
        for nodelet, config in self._by_nodelet(dict(self.expected)).items():
            try:
                present = {port.name: port.topic for port in remote.ports(nodelet)}
            except DyKnowError as error:
                raise CannotUndo(str(error)) from error
            for port, topic in config.items():
                if present.get(port) != topic:
                    raise CannotUndo(
                        f"{PortRef(nodelet, port)} has been connected to "
                        f"{present.get(port) or 'nothing'} by somebody else"
                    )

    def _by_nodelet(self, topics: Mapping[PortRef, str]) -> Dict[str, Dict[str, str]]:
        configs: Dict[str, Dict[str, str]] = {}
        for ref, topic in topics.items():
            configs.setdefault(ref.nodelet, {})[ref.port] = topic
        return configs


@dataclass(frozen=True)
class SpawnNodelet(Change):
    """Makes a nodelet."""

    label: str
    name: str
    config: Tuple[Tuple[str, str], ...] = ()
    is_protected: bool = False
    isolated: bool = False
    manager: str = ""

    @property
    def text(self) -> str:
        """What is done."""
        return f"create {self.name}"

    def apply(self, remote: Remote) -> Change:
        """Spawn it."""
        remote.spawn(
            self.label,
            self.name,
            dict(self.config),
            self.is_protected,
            self.isolated,
            self.manager,
        )
        return self

    def inverse(self, snapshot: Snapshot, library: Library) -> Change:
        """Destroy it."""
        return DestroyNodelet(self.name)


@dataclass(frozen=True)
class DestroyNodelet(Change):
    """Ends a nodelet."""

    name: str

    @property
    def text(self) -> str:
        """What is done."""
        return f"destroy {self.name}"

    def apply(self, remote: Remote) -> Change:
        """Destroy it."""
        remote.destroy(self.name)
        return self

    def inverse(self, snapshot: Snapshot, library: Library) -> Change:
        """Make it anew, connected as it is now."""
        nodelet = snapshot.nodelet(self.name)
        if nodelet is None:
            raise CannotUndo(f"nothing is known of {self.name}")
        if nodelet.transformation not in library:
            raise CannotUndo(
                f"{self.name} cannot be made anew: the library has no transformation of it"
            )
        return _remake(nodelet)


@dataclass(frozen=True)
class Protect(Change):
    """Protects a nodelet from being destroyed, or releases it."""

    name: str
    is_protected: bool

    @property
    def text(self) -> str:
        """What is done."""
        return f"{'protect' if self.is_protected else 'release'} {self.name}"

    def apply(self, remote: Remote) -> Change:
        """Set it."""
        remote.set_protection(self.name, self.is_protected)
        return self

    def inverse(self, snapshot: Snapshot, library: Library) -> Change:
        """Set it back."""
        return Protect(self.name, not self.is_protected)


def _remake(nodelet: NodeletStatus) -> Change:
    return SpawnNodelet(
        nodelet.transformation,
        nodelet.name,
        tuple((port.name, port.topic) for port in nodelet.ports if port.topic),
        nodelet.is_protected,
        nodelet.isolated,
        "" if nodelet.isolated else nodelet.manager,
    )
