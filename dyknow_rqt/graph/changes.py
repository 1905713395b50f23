# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Changes of the computation graph as values: each can be applied, and most undone.

A change calls a manager's client and raises its exceptions. ``inverse`` is called with the graph
as it was before the change.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Mapping, Optional, Sequence, Tuple, Union

from dyknow.errors import DyKnowError
from dyknow.model.client import BaseManagerClient
from dyknow.model.graph import PortRef, SpawnRequest
from dyknow.model.transformation import Transformation
from dyknow_rqt.graph.snapshot import Snapshot

Library = Mapping[str, Transformation]


class CannotUndo(DyKnowError):
    """A change cannot be undone; the text says why."""


class Change:
    """A change that the user makes."""

    @property
    def text(self) -> str:
        """The change in a few words."""
        raise NotImplementedError

    def apply(self, client: BaseManagerClient) -> Change:
        """Make the change; return it with the facts that are known afterwards."""
        raise NotImplementedError

    def inverse(self, snapshot: Snapshot, library: Library) -> Change:
        """Return the change that undoes this one, given the state before it.

        Raises:
            CannotUndo: it cannot be undone.
        """
        raise CannotUndo("there is no way back")

    def check(self, client: BaseManagerClient) -> None:
        """Check that no other client has changed the same things since; called before an undo.

        The snapshot of the window may be older than its own last change.

        Raises:
            CannotUndo: one has.
        """


@dataclass(frozen=True)
class Rewire(Change):
    """Connects ports of any number of nodelets: all of them, or none.

    Attributes:
        topics: the topic for each port; empty to disconnect it.
        text_: the change in a few words.
        expected: the topic that each port must have for the change to make sense; empty to
            check nothing.
    """

    topics: Tuple[Tuple[PortRef, str], ...]
    text_: str
    expected: Tuple[Tuple[PortRef, str], ...] = ()

    @property
    def text(self) -> str:
        """The change in words."""
        return self.text_

    @property
    def replaced(self) -> str:
        """The connections that end by it, in words; empty if there are none."""
        ends = dict(self.expected)
        lost = [f"{ends[ref]} at {ref}" for ref, topic in self.topics if ends.get(ref) and topic]
        return f"replaces {', '.join(lost)}" if lost else ""

    def apply(self, client: BaseManagerClient) -> Change:
        """Connect one nodelet after the other; if one fails, restore those before it."""
        before = dict(self.expected)
        done: List[str] = []
        configs = self._by_nodelet(dict(self.topics))
        try:
            for nodelet, config in configs.items():
                client.set_config(nodelet, config)
                done.append(nodelet)
        except DyKnowError:
            for nodelet, config in self._by_nodelet(before).items():
                if nodelet in done:
                    client.set_config(nodelet, config)
            raise
        return self

    def inverse(self, snapshot: Snapshot, library: Library) -> Change:
        """Connect the ports to their present topics."""
        now = []
        for ref, _ in self.topics:
            port = snapshot.port(ref)
            if port is None:
                raise CannotUndo(f"port {ref} is gone")
            now.append((ref, port.topic))
        return Rewire(tuple(now), f"undo: {self.text_}", self.topics)

    def check(self, client: BaseManagerClient) -> None:
        """Check that the ports are still connected as the change left them."""
        for nodelet, config in self._by_nodelet(dict(self.expected)).items():
            try:
                present = {port.name: port.topic for port in client.get_config(nodelet)}
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

    request: SpawnRequest

    @property
    def text(self) -> str:
        """The change in words."""
        return f"create {self.request.name}"

    def apply(self, client: BaseManagerClient) -> Change:
        """Spawn it."""
        client.spawn_nodelet(self.request)
        return self

    def inverse(self, snapshot: Snapshot, library: Library) -> Change:
        """Destroy it."""
        return DestroyNodelet(self.request.name)


@dataclass(frozen=True)
class DestroyNodelet(Change):
    """Destroys a nodelet."""

    name: str

    @property
    def text(self) -> str:
        """The change in words."""
        return f"destroy {self.name}"

    def apply(self, client: BaseManagerClient) -> Change:
        """Destroy it."""
        client.destroy(self.name)
        return self

    def inverse(self, snapshot: Snapshot, library: Library) -> Change:
        """Make it again, connected as it is now."""
        nodelet = snapshot.nodelet(self.name)
        if nodelet is None:
            raise CannotUndo(f"{self.name} is unknown")
        if nodelet.transformation not in library:
            raise CannotUndo(
                f"{self.name} cannot be made again: its transformation is not in the library"
            )
        return SpawnNodelet(nodelet.request)


def protection(names: Sequence[str], snapshot: Snapshot) -> Tuple[List[str], bool]:
    """Decide how a switch of the protection of nodelets wores.

    Returns:
        The nodelets to protect, those that are not yet; or if all are, all of them, to release.
    """
    nodelets = (snapshot.nodelet(name) for name in names)
    free = [each.name for each in nodelets if each is not None and not each.is_protected]
    return (free, True) if free or not names else (list(names), False)


@dataclass(frozen=True)
class Protect(Change):
    """Protects a nodelet from being destroyed, or releases it."""

    name: str
    is_protected: bool

    @property
    def text(self) -> str:
        """The change in words."""
        return f"{'protect' if self.is_protected else 'release'} {self.name}"

    def apply(self, client: BaseManagerClient) -> Change:
        """Set the protection."""
        client.set_protection(self.name, self.is_protected)
        return self

    def inverse(self, snapshot: Snapshot, library: Library) -> Change:
        """Set the protection to its present value."""
        return Protect(self.name, not self.is_protected)


#: The most changes that can be undone.
DEPTH = 100


@dataclass(frozen=True)
class DoneChange:
    """A change that was made, and its inverse or the reason why it has none."""

    change: Change
    back: Union[Change, CannotUndo]


class UndoHistory:
    """Two stacks: changes to undo and changes to redo."""

    def __init__(self) -> None:
        self._done: List[DoneChange] = []
        self._undone: List[Change] = []

    def note(self, change: Change, back: Union[Change, CannotUndo]) -> None:
        """Note a change; nothing can be redone after it."""
        self._done.append(DoneChange(change, back))
        del self._done[:-DEPTH]
        self._undone.clear()

    def note_undone(self) -> None:
        """Note that the last change was undone."""
        self._undone.append(self._done.pop().change)

    def note_redone(self, change: Change, back: Union[Change, CannotUndo]) -> None:
        """Note that the last undone change was redone."""
        self._undone.pop()
        self._done.append(DoneChange(change, back))

    def drop(self) -> None:
        """Forget the last change, which cannot be undone, so that those before it can be."""
        self._done.pop()

    @property
    def last(self) -> Optional[DoneChange]:
        """The change that undo undoes, or None."""
        return self._done[-1] if self._done else None

    @property
    def next(self) -> Optional[Change]:
        """The change that redo makes, or None."""
        return self._undone[-1] if self._undone else None

    @property
    def texts(self) -> Tuple[str, str]:
        """The changes that undo and redo would make, in words; empty for none."""
        return (
            self.last.change.text if self.last is not None else "",
            self.next.text if self.next is not None else "",
        )
