"""The manager, the proxies and the master as a command of the shell asks them: without a node.

Each call is a connection of its own with a time limit. Nothing registers with the master, so a
command starts fast and leaves no trace in the graph.
"""

from __future__ import annotations

import http.client
import os
import re
import time
import xmlrpc.client
from typing import Any, Callable, List, Mapping, Optional, Sequence, Tuple, TypeVar
from xml.parsers.expat import ExpatError

from dyknow import names
from dyknow.errors import PeerTimeout
from dyknow.manager.lifecycle import SpawnRequest
from dyknow.manager.model import PortState
from dyknow.ros.client_errors import Refused, Silent, Unreachable
from dyknow.ros.master import Master
from dyknow.ros.service_client import ServiceClient, ServiceFailed, ServiceLost
from dyknow.ros.snapshot import (
    Snapshot,
    Statistics,
    read_model,
    read_ports,
    read_statistics,
)

T = TypeVar("T")

#: Seconds that a question may take.
QUESTION_TIMEOUT = 5.0
#: Seconds that a change may take; a nodelet may need a new process and has then 10 s to come up.
CHANGE_TIMEOUT = 30.0
#: Seconds within which the manager's model follows a change that was made on a proxy.
FOLLOW_TIMEOUT = 2.0
_FOLLOW_PERIOD = 0.02
_OWN_MANAGER = re.compile(r".*/dyknow_(cpp_)?nodelet_manager(_[0-9]+)?\Z")


class ShellClient:
    """Asks one DyKnow manager and its nodelets; every answer is a plain value.

    Raises, in every method:
        Unreachable: there is no master, or the manager does not answer.
        Refused: the manager or the nodelet said no.
        Silent: the nodelet does not answer, or is not there.
    """

    def __init__(self, manager: str, timeout: Optional[float] = None) -> None:
        """Prepare questions; nothing is sent yet.

        Args:
            manager: global name of the manager's node.
            timeout: seconds for each answer; None for what suits the question.
        """
        self.manager = manager
        #: Where relative names of nodelets begin.
        self.namespace = names.parent(manager)
        self._question = QUESTION_TIMEOUT if timeout is None else timeout
        self._change = CHANGE_TIMEOUT if timeout is None else timeout
        self._master = Master(f"/dyknow_{os.getpid()}", timeout=min(self._question, 3.0))
        self._master_seen = False

    # The model

    def nodelets(self) -> Snapshot:
        """Return the model without transformations, from the manager's latched topic."""
        from dyknow_msgs.msg import Model

        from dyknow.ros.latched import read_latched

        self._find_master()
        topic = f"{self.manager}/model"
        try:
            message = read_latched(self._master, self.manager, topic, Model, self._question)
        except LookupError:
            raise self._no_manager("is not running") from None
        except PeerTimeout:
            raise self._no_manager(f"did not answer within {self._question:g} s") from None
        except OSError as error:
            raise self._no_manager(f"is registered, but does not answer ({error})") from error
        return read_model(message)

    def model(self) -> Snapshot:
        """Return the model with its transformations."""
        from dyknow_msgs.srv import GetModel

        return read_model(self._ask_manager("get_model", GetModel, self._question).model)

    # Changes by the manager

    def add_transformation(self, text: str) -> Tuple[List[str], List[str]]:
        """Add what a specification says; return the labels, and warnings."""
        from dyknow_msgs.srv import AddTransformation

        answer = self._ask_manager(
            "add_transformation", AddTransformation, self._change, specification=text
        )
        return list(answer.labels), answer.message.splitlines()

    def remove_transformation(self, label: str) -> None:
        """Remove a transformation."""
        from dyknow_msgs.srv import RemoveTransformation

        self._ask_manager("remove_transformation", RemoveTransformation, self._change, label=label)

    def spawn(self, request: SpawnRequest) -> None:
        """Make a nodelet."""
        from dyknow_msgs.srv import Spawn

        self._ask_manager(
            "spawn",
            Spawn,
            self._change,
            label=request.label,
            name=request.name,
            is_protected=request.is_protected,
            isolated=request.isolated,
            config=_config(request.config),
            manager=request.manager,
        )

    def destroy(self, name: str) -> None:
        """Destroy a nodelet."""
        from dyknow_msgs.srv import Destroy

        self._ask_manager("destroy", Destroy, self._change, name=name)

    def set_protection(self, name: str, is_protected: bool) -> None:
        """Protect a nodelet, or release it."""
        from dyknow_msgs.srv import SetProtection

        self._ask_manager(
            "set_protection", SetProtection, self._change, name=name, is_protected=is_protected
        )

    # The nodelets' proxies

    def get_config(self, nodelet: str) -> Tuple[PortState, ...]:
        """Return the ports of a nodelet as they are this moment, without tags."""
        from dyknow_msgs.srv import GetConfig

        answer = self._ask_nodelet(nodelet, "get_config", GetConfig, self._question)
        return read_ports(answer.ports)

    def set_config(self, nodelet: str, topics: Mapping[str, str]) -> None:
        """Connect ports of a nodelet, all or none."""
        from dyknow_msgs.srv import SetConfig

        self._ask_nodelet(nodelet, "set_config", SetConfig, self._change, config=_config(topics))

    def get_statistics(self, nodelet: str) -> Statistics:
        """Return what a nodelet has done."""
        from dyknow_msgs.srv import GetStatistics

        return read_statistics(
            self._ask_nodelet(nodelet, "get_statistics", GetStatistics, self._question)
        )

    def wait_until_known(self, wanted: Mapping[str, Mapping[str, str]]) -> bool:
        """Wait until the manager's model shows these topics of ports, nodelet by nodelet.

        The next command then sees what this one has done.

        Returns:
            Whether it does within the time that the model needs at most.
        """
        deadline = time.monotonic() + FOLLOW_TIMEOUT
        while not _shows(self.nodelets(), wanted):
            if time.monotonic() > deadline:
                return False
            time.sleep(_FOLLOW_PERIOD)
        return True

    # The master

    def nodelet_managers(self) -> List[str]:
        """Names of all nodelet managers of the ROS graph that are registered now."""
        return self._nodes_with("/load_nodelet")

    def managers(self) -> List[str]:
        """Names of all DyKnow managers of the ROS graph that are registered now."""
        return self._nodes_with("/add_transformation")

    def topics(self) -> List[str]:
        """Names of all topics that the master knows."""
        self._find_master()
        known = self._on_master(lambda: self._master.ask("getTopicTypes"))
        return sorted(name for name, _ in known)

    def is_own_manager(self, name: str) -> bool:
        """Whether a nodelet manager is one that the DyKnow manager starts when it is needed."""
        return names.parent(name) == self.namespace and bool(_OWN_MANAGER.match(name))

    # Inside

    def _nodes_with(self, suffix: str) -> List[str]:
        self._find_master()
        _, _, services = self._on_master(lambda: self._master.ask("getSystemState"))
        return sorted(name[: -len(suffix)] for name, _ in services if name.endswith(suffix))

    def _ask_manager(
        self, service: str, service_class: Any, timeout: float, **request: Any
    ) -> Any:
        self._find_master()
        client = ServiceClient(self._master, f"{self.manager}/{service}", service_class)
        try:
            answer = client.call(timeout, **request)
        except ServiceFailed as error:
            raise Refused(str(error)) from error
        except ServiceLost as error:
            why = "is not running" if "is not offered" in str(error) else f"is broken: {error}"
            raise self._no_manager(why) from error
        except PeerTimeout as error:
            raise self._no_manager(f"did not answer within {timeout:g} s") from error
        return _checked(answer)

    def _ask_nodelet(
        self, nodelet: str, service: str, service_class: Any, timeout: float, **request: Any
    ) -> Any:
        self._find_master()
        client = ServiceClient(self._master, f"{nodelet}/{service}", service_class)
        try:
            answer = client.call(timeout, **request)
        except ServiceFailed as error:
            raise Refused(f"nodelet '{nodelet}': {error}") from error
        except (ServiceLost, PeerTimeout) as error:
            raise Silent(f"nodelet '{nodelet}' does not answer: {error}") from error
        return _checked(answer)

    def _find_master(self) -> None:
        if not self._master_seen:
            self._on_master(lambda: self._master.ask("getPid"))
            self._master_seen = True

    def _on_master(self, ask: Callable[[], T]) -> T:
        try:
            return ask()
        except (
            PeerTimeout,
            OSError,
            LookupError,
            ValueError,
            TypeError,
            ExpatError,
            http.client.HTTPException,
            xmlrpc.client.Error,
        ) as error:
            cause = error.__cause__ or error
            # The text of an error of the socket without its number.
            words = re.sub(r"^\[Errno -?\d+\] ", "", str(cause)) or type(cause).__name__
            raise Unreachable(
                f"no ROS master at {self._master.uri} ({words}): is roscore running, and "
                "ROS_MASTER_URI right?"
            ) from error

    def _no_manager(self, why: str) -> Unreachable:
        return Unreachable(
            f"DyKnow manager '{self.manager}' {why}: start one with 'rosrun dyknow manager', or "
            "name another with --manager-node or $DYKNOW_MANAGER"
        )


def _config(topics: Mapping[str, str]) -> Sequence[Any]:
    from dyknow_msgs.msg import PortConfig

    return [PortConfig(port, topic) for port, topic in topics.items()]


def _checked(answer: Any) -> Any:
    if not getattr(answer, "success", True):
        raise Refused(answer.message)
    return answer


def _shows(snapshot: Snapshot, wanted: Mapping[str, Mapping[str, str]]) -> bool:
    for name, topics in wanted.items():
        nodelet = snapshot.nodelet(name)
        if nodelet is None:
            return False
        found = {port.name: port.topic for port in nodelet.ports}
        if any(found.get(port) != topic for port, topic in topics.items()):
            return False
    return True
