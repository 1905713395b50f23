# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Sets the stage for the story: a ROS master, a manager that knows the field, and a node.

A master or manager that runs is used; otherwise one is started, and ended with the story.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Callable, Iterator

import rospkg
import rospy

from dyknow.errors import DyKnowError, HostError, PeerTimeout
from dyknow.ros.client import ManagerClient
from dyknow.ros.master import Master
from dyknow_demo.processes import (
    MANAGER,
    NAMESPACE,
    START_TIMEOUT,
    Processes,
    check_real_time,
    find_master,
    start_manager,
)
from dyknow_demo.soccer.story import Script, tell_story, wait_for

#: Seconds that nodelets may go on if the manager is killed.
_ORPHAN_TIMEOUT = 3.0


def play(manager: str, seconds: float, max_silence: float, pictures: Path) -> bool:
    """Tell the story.

    Args:
        manager: a running one that knows the field; empty to start one.
        seconds: for each act.
        max_silence: seconds without a position that the claim allows.
        pictures: folder for the drawings.

    Returns:
        Whether the position was never lost for longer than that.

    Raises:
        DyKnowError: something failed.
    """
    with Processes() as processes:
        _tell(f"ROS master: {find_master(processes)}")
        check_real_time()
        with _manager(manager) as (client, check), _node():
            wait_for(client, check, START_TIMEOUT)
            script = Script(seconds, max_silence, pictures.absolute(), _tell, check)
            return tell_story(client, script)


@contextlib.contextmanager
def _manager(name: str) -> Iterator[tuple[ManagerClient, Callable[[], None]]]:
    """Use a manager, or start one; yields its client and a check that raises if it has ended."""
    if name:
        client = ManagerClient(name)
        _tell(f"manager: {client.manager}")
        yield client, lambda: None
        return
    client = ManagerClient(MANAGER)
    if _answers(client):
        raise DyKnowError(f"{MANAGER} runs at this master already: another demonstration?")
    examples = Path(rospkg.RosPack().get_path("dyknow")) / "examples"
    try:
        with Processes() as processes:
            pid = start_manager(
                processes,
                lambda: _answers(client),
                ontologies=examples / "ontologies" / "soccer.ttl",
                transformations=examples / "transformations" / "soccer.xml",
                orphan_timeout=_ORPHAN_TIMEOUT,
            )
            _tell(f"manager: {MANAGER}, process {pid}")
            yield client, processes.check
    finally:
        _forget_parameters()


@contextlib.contextmanager
def _node() -> Iterator[None]:
    """Make this process a node for a while: ``dyknow.acquire`` needs one."""
    rospy.init_node("dyknow_demo", anonymous=True, disable_signals=True)
    try:
        yield
    finally:
        rospy.signal_shutdown("the demonstration is over")


def _answers(client: ManagerClient) -> bool:
    try:
        client.get_model(1.0)
    except (HostError, PeerTimeout):
        return False
    return True


def _forget_parameters() -> None:
    """Delete the parameters of the started nodelets."""
    with contextlib.suppress(LookupError, PeerTimeout):
        Master(NAMESPACE).ask("deleteParam", NAMESPACE)


def _tell(text: str) -> None:
    print(text, flush=True)
