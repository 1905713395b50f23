"""Nodelet managers that the DyKnow manager did not start, on any host of the ROS graph.

The kept connection to its ``list`` service shows that such a peer is there; when it breaks, the
peer was restarted or is gone, and is identified anew.
"""

from __future__ import annotations

import threading
from typing import Any, List

from nodelet.srv import NodeletList

from dyknow.errors import HostError, PeerTimeout
from dyknow.manager.host import Kind
from dyknow.ros.master import Master
from dyknow.ros.service_client import ServiceClient

#: Seconds for a peer's answers.
TIMEOUT = 1.0
_PYTHON_SIGN = "changes"


class ListClient:
    """Asks one process of a nodelet manager what it runs, over a connection that is kept.

    When the connection breaks another process may have the name by now. Its list says nothing of
    the nodelets of this one, so it is not taken for an answer.
    """

    def __init__(self, master: Master, name: str) -> None:
        """Prepare; nothing is sent yet."""
        self._client = ServiceClient(master, f"{name}/list", NodeletList, persistent=True)
        self._address = ""
        #: Whether the last question was answered in time.
        self.answers = True

    def list(self) -> List[str]:
        """Ask.

        Raises:
            PeerTimeout: no answer in time.
            HostError: it is not there, or another process has its name.
        """
        try:
            names: Any = self._client.call(TIMEOUT).nodelets
        except PeerTimeout:
            self.answers = False
            raise
        self.answers = True
        self._address = self._address or self._client.address
        if self._client.address != self._address:
            self._client.close()
            raise HostError("another process has that name now")
        return sorted(names)

    @property
    def connected(self) -> bool:
        """Whether the connection was there when it was used last."""
        return self._client.connected

    def close(self) -> None:
        """Close the connection."""
        self._client.close()


class Peer:
    """One nodelet manager of others."""

    def __init__(self, master: Master, name: str) -> None:
        """Know only its name."""
        self.name = name
        self.kind = Kind.PYTHON
        self.incarnation = ""
        self.client = ListClient(master, name)
        self._master = master
        self._turn = threading.Lock()

    def look(self) -> None:
        """Find out whether it is there and who it is, unless that is known."""
        with self._turn:
            if self.incarnation and self.client.connected:
                return
            self.client.close()
            self.client = ListClient(self._master, self.name)
            try:
                self.incarnation = self._identify()
            except (HostError, PeerTimeout, LookupError):
                self.incarnation = ""

    def _identify(self) -> str:
        uri = self._master.node(self.name)
        if not uri:
            return ""
        self.client.list()
        publishes = self._master.publishers(f"{self.name}/{_PYTHON_SIGN}")
        self.kind = Kind.PYTHON if self.name in publishes else Kind.CPP
        return f"{uri}@{self._master.pid(self.name, uri, TIMEOUT)}"
