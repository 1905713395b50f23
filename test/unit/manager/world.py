# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""A manager on the fake host, with a library of small transformations."""

from __future__ import annotations

from typing import Any

from dyknow.guards import NO_GUARDS, Guards
from dyknow.manager.graph import Graph
from dyknow.manager.library import Library
from dyknow.manager.manager import Manager
from dyknow.manager.store import Store
from dyknow.manager.supervision.lifecycle import ManagerContext
from dyknow.model.graph import SpawnRequest
from dyknow.periodic import STEADY, Clock
from dyknow.simulated.host import FakeHost

SOURCES = {
    "pkg/Camera": [("image", "out", "sensor_msgs/Image")],
    "pkg/Relay": [("in", "in", "sensor_msgs/Image"), ("out", "out", "sensor_msgs/Image")],
    "pkg/Native": [("image", "in", "sensor_msgs/Image"), ("out", "out", "sensor_msgs/Image")],
}

CAMERA = """<transformation>
    <label>camera</label>
    <source>pkg/Camera</source>
    <params><param name="rate" type="double">30</param></params>
    <ports><port type="out" datatype="sensor_msgs/Image">image</port></ports>
    <tags><tag port="image">Raw(camera)</tag></tags>
  </transformation>"""
RELAY = """<transformation>
    <label>relay</label>
    <source>pkg/Relay</source>
    <ports><port type="in">in</port><port type="out">out</port></ports>
  </transformation>"""
LIBRARY = f"""
<transformations>
{CAMERA}
{RELAY}
  <transformation>
    <label>native</label>
    <source>pkg/Native</source>
    <ports>
      <port type="in" datatype="sensor_msgs/Image">image</port>
      <port type="out" datatype="sensor_msgs/Image">~out</port>
    </ports>
  </transformation>
  <transformation type="topic">
    <label>joints</label>
    <source>/joint_states</source>
    <ports><port type="out" datatype="sensor_msgs/JointState">joints</port></ports>
  </transformation>
  <transformation>
    <label>wrong ports</label>
    <source>pkg/Relay</source>
    <ports><port type="out">in</port><port type="in">missing</port></ports>
  </transformation>
  <transformation>
    <label>wrong type</label>
    <source>pkg/Relay</source>
    <ports><port type="in" datatype="std_msgs/Header">in</port></ports>
  </transformation>
  <transformation>
    <label>stranger</label>
    <source>pkg/Stranger</source>
  </transformation>
</transformations>
"""

TRACKER = """<transformation><label>tracker</label><source>pkg/Relay</source>
  <params><param name="frame" type="string">${?camera}_link</param></params>
  <ports><port type="in">in</port><port type="out">out</port></ports>
  <tags><tag port="in">Image(?camera)</tag></tags></transformation>"""


class Killed(BaseException):
    """Ends the manager as ``kill -9`` does."""


class World:
    """Everything that outlives a manager, and the current manager."""

    def __init__(
        self,
        path: str = ":memory:",
        guards: Guards = NO_GUARDS,
        clock: Clock = STEADY,
    ) -> None:
        self.clock = clock
        self.host = FakeHost(SOURCES)
        self.host.cpp.add("pkg/Native")
        self.host.stock = True
        self.path = path
        self.guards = guards
        self.open()
        self.manager.add_transformation(LIBRARY) if not guards.read_only else None

    def open(self) -> None:
        """Start a manager on the content of the store."""
        self.store = Store(self.path, self.clock.now)
        library, graph = Library(self.store), Graph(self.store, self.clock)
        self.manager = Manager(
            ManagerContext(self.host, self.store, library, graph, self.guards, self.clock)
        )
        self.manager.start()

    def kill_manager(self) -> None:
        """End the manager as kill -9 does, and start another."""
        self.open()

    def spawn(self, label: str, name: str, **kwds: Any) -> Any:
        """Spawn with keywords."""
        return self.manager.spawn(SpawnRequest(label, name, **kwds))

    def states(self) -> dict[str, str]:
        """State of each nodelet in the model."""
        return {each.name: each.state.name for each in self.manager.graph.all()}
