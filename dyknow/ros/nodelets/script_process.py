# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""An unchanged script of rospy in a process of its own, with ports.

It runs on the main thread, as ever. Its ``rospy.init_node`` makes the process a node as rospy's
does, with the services of a proxy; until then, and for a script that never calls it, this is plain
Python.
"""

from __future__ import annotations

import contextlib
import inspect
import os
import signal
import sys
import threading
from dataclasses import replace
from typing import Any, Sequence

if __name__ == "__main__":
    import dyknow.interruptible
    import dyknow.ros.lean  # noqa: F401
import rosgraph.names
import rospy

from dyknow import names
from dyknow.errors import CannotRun
from dyknow.locks import turn_lock
from dyknow.model.graph import NodeletKind
from dyknow.nodelet.context import Context
from dyknow.nodelet.handle import Nodelet
from dyknow.periodic import in_background
from dyknow.ros.nodelets.nodelet_manager import NodeletManager, Settings
from dyknow.ros.nodelets.process_guards import SPAWNED
from dyknow.ros.parameters import PrivateParameters
from dyknow.ros.process.node_process import init_node, log_without_the_master
from dyknow.ros.process.signals import keep_waits_steady, on_signals
from dyknow.ros.scripts.sandbox import Sandbox, join_all
from dyknow.ros.scripts.script import NodeArguments, ScriptCode
from dyknow.ros.scripts.script_ports import ScriptHandle

#: Python's own, with which a lone script runs as ever.
_SETTINGS = Settings(num_worker_threads=2, switch_interval=0.005)
#: Seconds that the script's main thread has to end before its topics are withdrawn.
_PATIENCE = 0.5
#: Seconds for all of the end.
_LONGEST_END = 5.0

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
#: Arguments of ``rospy.init_node`` that must not differ between two calls.
_NOTED = ("name", "argv", "anonymous", "log_level", "disable_rostime", "disable_signals")


def main(argv: Sequence[str] | None = None) -> int:
    """Run a script as the process's main program; returns the exit code.

    Args:
        argv: the command line: the script, then its arguments; by default the process's.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    try:
        return _ScriptProcess(words).run()
    except CannotRun as error:
        print(error, file=sys.stderr)
        return 2


class _ScriptProcess:
    """One script; the main thread runs it."""

    def __init__(self, argv: list[str]) -> None:
        self._argv = argv
        sys.path[0] = os.path.dirname(argv[0])
        self._sandbox = Sandbox(os.path.basename(argv[0]), threading.main_thread(), is_alone=True)
        self._code = ScriptCode(self._sandbox, argv, self._init_node)
        self._node_args = NodeArguments()
        self._main_over = threading.Event()
        self._is_begun = threading.Event()
        self._manager: NodeletManager | None = None
        self._have_no_node()
        os.register_at_fork(after_in_child=self._have_no_node)

    def run(self) -> int:
        """Run it to its end, and to that of the threads that it leaves."""
        sys.modules["__main__"] = self._code.module
        sys.argv = self._sandbox.argv = self._argv
        status, is_interrupted = 0, False
        if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:  # dyknow.interruptible's
            signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            self._code.execute()
        except SystemExit as end:
            status = _status(end)
        except BaseException as error:
            status, is_interrupted = 1, type(error) is KeyboardInterrupt
            _report(error, vars(self._code.module)["__file__"])
        join_all(lambda: [each for each in threading.enumerate() if not each.daemon])
        self._sandbox.run_exits()
        self._main_over.set()
        self._sandbox.shut_down("the script has ended")
        in_background("end", self._stop).join(_LONGEST_END)
        if is_interrupted:
            _end_by(signal.SIGINT)
        return status

    def _init_node(self, *args: Any, **kwds: Any) -> None:
        """``rospy.init_node``, for the script."""
        call = inspect.signature(rospy.init_node).bind(*args, **kwds)
        call.apply_defaults()
        options = call.arguments
        if not self._node_args.note(*(options[name] for name in _NOTED)):
            return
        if not options["disable_signals"]:
            self._listen_for_signals()
        given = list(self._argv if options["argv"] is None else options["argv"])
        mappings = self._sandbox.mappings = rosgraph.names.load_mappings(given)
        renamed = {source: to for source, to in mappings.items() if not source.startswith("__")}
        # Names are remapped by the proxy, which connects ports to any topic: not by rospy.
        kept = [word for word in given if word.partition(":=")[0] not in renamed]
        rospy.on_shutdown(self._on_shutdown)
        try:
            self._be_node({**options, "argv": kept, "disable_signals": True}, renamed)
        finally:
            self._is_begun.set()

    def _be_node(self, options: dict[str, Any], renamed: dict[str, str]) -> None:
        self._shut_down = init_node(**options)
        log_without_the_master()
        self._sandbox.name = rospy.get_name()
        with self._withdrawal_turn:
            if self._sandbox.is_ending:
                raise rospy.ROSInitException("init_node interrupted before it could complete")
            self._offer(renamed)

    def _offer(self, renamed: dict[str, str]) -> None:
        nodelet_class = self._nodelet_class()
        given = PrivateParameters(rospy.get_param("~", {}))
        self._manager = NodeletManager(
            replace(_SETTINGS, shared_memory=given.flag("shared_memory", _SETTINGS.shared_memory)),
            lambda type_name, context: nodelet_class,
            bound=SPAWNED in os.environ,
        )
        name = rospy.get_name()
        remappings = names.pair_remappings(
            name, list(renamed), list(renamed.values()), names.parent(name)
        )
        self._manager.be(NodeletKind.NODE, remappings)

    def _nodelet_class(self) -> type[Nodelet]:
        sandbox, main_over, stop = self._sandbox, self._main_over, self._stop

        class Itself(Nodelet):
            """Stands for the script among the nodelets, of which it is the only one."""

            def bind(self, context: Context) -> None:
                context.executor = context.runtime.blocking
                context.unload = stop
                super().bind(context)

            def on_init(self) -> None:
                sandbox.begin(ScriptHandle(self.mt_node_handle))

            def on_shutdown(self) -> None:
                sandbox.shut_down("unloaded")
                main_over.wait(_PATIENCE)

        return Itself

    def _listen_for_signals(self) -> None:
        """End in order at a signal; handlers that the script had set are called then, too."""
        if threading.current_thread() is not threading.main_thread():
            return
        on_signals(_SIGNALS, self._stop)
        keep_waits_steady()

    def _have_no_node(self) -> None:
        """Begin without a node; a forked child leaves it to the parent.

        The child has the locks of the parent's threads, not these themselves.
        """
        self._manager = None
        self._withdrawal_turn = turn_lock("end of a script")
        self._shut_down = threading.Event()
        self._shut_down.set()

    def _stop(self) -> None:
        """End the node; returns when it is done."""
        self._withdraw()
        rospy.signal_shutdown("told to end")
        self._shut_down.wait(_LONGEST_END)

    def _on_shutdown(self) -> None:
        """Hold up a shutdown by rosnode kill: a node that is starting starts, and ends then."""
        if rospy.core.is_initialized():
            self._is_begun.wait(_LONGEST_END)
        self._withdraw()

    def _withdraw(self) -> None:
        """Withdraw the script's registrations."""
        self._sandbox.shut_down("shutdown")  # however long its hooks take, as in rospy
        with self._withdrawal_turn:
            manager, self._manager = self._manager, None
            if manager is not None:
                manager.close()


def _status(end: SystemExit) -> int:
    """The exit code of a SystemExit, as Python has it."""
    if end.code is None or isinstance(end.code, int):
        return end.code or 0
    print(end.code, file=sys.stderr)
    return 1


def _report(error: BaseException, file: str) -> None:
    """Report an error that ends the script, with a traceback that begins in it."""
    trace = error.__traceback__
    while trace is not None and trace.tb_frame.f_code.co_filename != file:
        trace = trace.tb_next
    error.__traceback__ = trace or error.__traceback__
    sys.excepthook(type(error), error, error.__traceback__)


def _end_by(number: int) -> None:
    """End this process as Python does when nothing catches a KeyboardInterrupt."""
    with contextlib.suppress(OSError):
        sys.stdout.flush()
        sys.stderr.flush()
    signal.signal(number, signal.SIG_DFL)
    os.kill(os.getpid(), number)


if __name__ == "__main__":
    sys.exit(main())
