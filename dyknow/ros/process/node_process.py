# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Runs a node in this process, from its start to an orderly end.

rospy's own signal handler runs its whole shutdown in the main thread, in the middle of whatever
that is doing: when it is calling the master, the shutdown waits for ever for the lock that the
call holds. So here the main thread only waits, and everything else has another one.
"""

from __future__ import annotations

import contextlib
import enum
import gc
import logging
import os
import queue
import signal
import sys
import threading
import time
from typing import Any, Callable, Mapping, Sequence

import rosgraph.names
import rospy
from rosgraph.roslogging import RosStreamHandler
from rospy.impl.masterslave import ROSHandler
from rospy.impl.paramserver import get_param_server_cache
from rospy.impl.registration import (
    RegManager,
    get_registration_listeners,
    get_service_manager,
    get_topic_manager,
)

from dyknow import names
from dyknow.errors import BadParameter, CannotRun, DyKnowError
from dyknow.nodelet.loading.memory import use_one_heap
from dyknow.nodelet.middleware import Closable
from dyknow.periodic import in_background
from dyknow.ros.process import descriptors
from dyknow.ros.process.signals import (
    DONE,
    FAILED,
    INTERRUPTED,
    keep_waits_steady,
    on_signals,
)

#: Seconds for a start that is going on to be complete, so that it can be closed.
_START_PATIENCE = 2.0
#: Seconds for closing, when it is rosnode kill that ends the process.
_CLOSE_PATIENCE = 10.0
#: Seconds for rospy to take back its registrations.
_SHUTDOWN_PATIENCE = 2.0
#: The same for a node that was never initialised.
_SHORT_PATIENCE = 0.5
_WITHDRAWAL_PATIENCE = 1.0  # seconds for other threads to withdraw what they are at
_LOOK_AGAIN = 0.25  # seconds between two looks for a master that went away during the start
#: Part of the master's shutdown message to a node whose name another one has registered.
_DISPLACED = "new node registered with same name"


class _Order(enum.Enum):
    """Reasons for the main thread's wait to end."""

    END = enum.auto()
    FAIL = enum.auto()
    START_AGAIN = enum.auto()


class NodeProcess:
    """Runs one thing in a node of its own until SIGINT, SIGTERM or rosnode kill.

    Args:
        node: default name of the node.
        argv: the command line with ROS's own arguments, program name first.
        start: called once the node is initialised; returns an object to close at the end, or
            None if it failed and has said so. A `DyKnowError` is logged, and ends the process;
            where the ROS master refuses a connection, everything begins again with the next one.
        on_displaced: called when the master says that another node has registered under this
            name; by default that ends the node, as rosnode kill does.
    """

    def __init__(
        self,
        node: str,
        argv: Sequence[str],
        start: Callable[[], Closable | None],
        on_displaced: Callable[[], object] | None = None,
    ) -> None:
        use_one_heap()  # first: a thread that has a heap keeps it
        self._node = node
        self._argv = list(argv)
        self._start = start
        self._on_displaced = on_displaced
        self._running: Closable | None = None
        self._told: queue.SimpleQueue[_Order] = queue.SimpleQueue()
        self._variables: Mapping[str, str] = {}
        self._closed = threading.Event()
        self._shut_down = threading.Event()
        self._shut_down.set()

    def end(self) -> None:
        """End it as SIGTERM does; from any thread, and at any time, even before it runs."""
        self._told.put(_Order.END)

    def start_again(self, variables: Mapping[str, str]) -> None:
        """Run the same command line afresh in this process, with further variables."""
        self._variables = variables
        self._told.put(_Order.START_AGAIN)

    def run(self) -> int:
        """Run, and return the exit code."""
        on_signals((signal.SIGINT, signal.SIGTERM), self.end)
        keep_waits_steady()
        starting = in_background("start", self._begin)
        order = self._told.get()
        if order is _Order.START_AGAIN:
            _execute_again(self._variables)
        if not rospy.core.is_initialized():
            self._closed.set()
            _shut_down(_SHORT_PATIENCE)  # also ends the wait for a master
        starting.join(_START_PATIENCE)
        if self._running is not None:
            self._running.close()
        self._closed.set()
        _shut_down(_SHORT_PATIENCE if self._shut_down.is_set() else _SHUTDOWN_PATIENCE)
        self._shut_down.wait(_SHUTDOWN_PATIENCE)
        if order is _Order.FAIL:
            return FAILED
        return DONE if self._running is not None else INTERRUPTED

    def _begin(self) -> None:
        try:
            if self._on_displaced is not None:
                _hear_of_displacement(self._on_displaced)
            descriptors.spare()
            names.check(name_of(self._argv, self._node), "name of a node")
            rospy.on_shutdown(self._on_shutdown)
            self._shut_down = init_node(self._node, argv=self._argv, disable_signals=True)
            log_without_the_master()
            _print_logs_at_least()
            descriptors.enlarge_queue()
            gc.freeze()  # a full collection of garbage would look at all imports, for 10 ms
            self._running = self._start()
        except BaseException as error:
            if rospy.core.is_shutdown_requested():
                pass  # It is told to end already.
            elif any(isinstance(each, ConnectionError) for each in (error, error.__cause__)):
                self._begin_again(error)
                return
            elif isinstance(error, DyKnowError):
                rospy.logfatal("%s", error)
                if isinstance(error, BadParameter):
                    self._forget(error.name)
            else:
                self._told.put(_Order.FAIL)
                raise
        if self._running is None:
            self._told.put(_Order.FAIL)

    def _begin_again(self, error: BaseException) -> None:
        """Start again as soon as there is a ROS master: rospy gives up where there is none."""
        while not rospy.core.is_shutdown_requested():
            with contextlib.suppress(OSError):
                rospy.get_master().getPid()
                rospy.logwarn("the ROS master was away (%s); starting again", error)
                self.start_again({})
                return
            time.sleep(_LOOK_AGAIN)

    def _forget(self, parameter: str) -> None:
        """Delete a private parameter that the command line has set.

        The parameter server would keep it, and the next start would fail too.
        """
        if is_given(self._argv, parameter.lstrip("~")):
            with contextlib.suppress(KeyError, rospy.ROSException):
                rospy.delete_param(parameter)
        else:
            rospy.logfatal(
                "it is on the parameter server: rosparam set %s VALUE, or rosparam delete it",
                rospy.resolve_name(parameter),
            )

    def _on_shutdown(self) -> None:
        """Hold up a shutdown by rosnode kill until everything is closed in order."""
        self.end()
        self._closed.wait(_CLOSE_PATIENCE)


def init_node(name: str, **options: Any) -> threading.Event:
    """Become a node, as by `rospy.init_node`, whose shutdown takes no longer than it has to.

    Returns:
        An event that is set once rospy's shutdown has called its hooks. Only then may the main
        thread end: where another one shuts down (rosnode kill), ``rospy.signal_shutdown`` does
        not wait.

    Raises:
        CannotRun: the log cannot be written.
        rospy.ROSInitException: a shutdown has begun meanwhile.
    """
    shut_down = threading.Event()
    # From now on: a hook that is added while a shutdown runs waits for its end, and is dropped.
    rospy.core.add_preshutdown_hook(lambda reason: _prepare_end(shut_down))
    try:
        rospy.init_node(name, **options)
    except OSError as error:
        if error.filename is None:
            raise
        raise CannotRun(
            f"the log cannot be written: {error.strerror}: '{error.filename}'; set ROS_LOG_DIR to "
            "a folder that can be written"
        ) from error
    return shut_down


def _prepare_end(shut_down: threading.Event) -> None:
    """Prepare rospy's withdrawal of all registrations, which follows; set an event at its end.

    A thread that is just withdrawing one has taken it from rospy's lists already, and must tell
    the master before the process ends: with these locks that is waited for. And rospy wakes the
    thread that keeps registrations just before that may end, and then joins it: it would look
    again within 0.5 s.
    """
    manager = registration_manager()
    locks = (get_topic_manager().lock, get_service_manager().lock)
    held = [lock for lock in locks if lock.acquire(timeout=_WITHDRAWAL_PATIENCE)]

    def end(reason: str) -> None:
        for lock in held:
            lock.release()
        if manager is not None:
            with manager.cond:
                manager.cond.notify_all()
        shut_down.set()

    rospy.core.add_shutdown_hook(end)


def registration_manager() -> RegManager | None:
    """Return rospy's keeper of registrations; None before the node is initialised."""
    listeners = list(get_registration_listeners().listeners)
    return next((each for each in listeners if isinstance(each, RegManager)), None)


def name_of(argv: Sequence[str], default: str) -> str:
    """Return the name of the node of a command line."""
    name = rosgraph.names.load_mappings(argv).get("__name", default)
    return names.join(rosgraph.names.get_ros_namespace(argv=argv), str(name))


def is_given(argv: Sequence[str], parameter: str) -> bool:
    """Whether a command line sets a private parameter, rather than a launch file or a user."""
    return any(word.startswith(f"_{parameter}:=") for word in argv)


def log_without_the_master() -> None:
    """Ask for the parameter of rospy's log once; the master tells of its changes.

    Where it is not set, rospy asks for it with each line, and waits for a master that is away.
    """
    is_set = False
    with contextlib.suppress(OSError, rospy.ROSException):
        is_set = bool(rospy.get_param_cached(names.LOG_PARAMETER, False))
    if not is_set:
        get_param_server_cache().set(names.LOG_PARAMETER, False)


def _print_logs_at_least() -> None:
    """Print the log where rospy could not write its log files; it would be silent otherwise."""
    logger = logging.getLogger("rosout")
    if not any(isinstance(each, RosStreamHandler) for each in logger.handlers):
        logger.setLevel(logging.INFO)
        logger.addHandler(RosStreamHandler())


def _shut_down(patience: float) -> None:
    """Let rospy shut down, and wait for it at most ``patience`` seconds.

    A node that waits for its master holds a lock that the shutdown needs, and releases it only
    after the shutdown.
    """
    in_background("shutdown", lambda: rospy.signal_shutdown("told to end")).join(patience)


def _hear_of_displacement(displaced: Callable[[], object]) -> None:
    """Call ``displaced`` in place of the shutdown that the master asks for."""
    shutdown = ROSHandler.shutdown

    def heard(handler: Any, caller_id: Any, msg: Any = "") -> Any:
        if _DISPLACED not in str(msg):
            return shutdown(handler, caller_id, msg)
        displaced()
        return 1, "another node bears the name; this one looks which of them goes on", 0

    ROSHandler.shutdown = heard


def _execute_again(variables: Mapping[str, str]) -> None:
    """Put a new run of this process's command line in its place; does not return."""
    with open("/proc/self/cmdline", "rb") as file:
        command = file.read().split(b"\0")[:-1]
    sys.stdout.flush()
    sys.stderr.flush()
    os.execve(sys.executable, command, {**os.environ, **variables})
