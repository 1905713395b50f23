# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The nodelet that an unchanged script of rospy is, and the way in which a script is run."""

from __future__ import annotations

import logging
import threading
import traceback
from typing import Any, Callable, Sequence

import rospy

from dyknow.errors import CannotRun, NeedsProcess, ScriptEnded
from dyknow.nodelet.context import Context
from dyknow.nodelet.handle import Nodelet
from dyknow.nodelet.loading.module_files import script_file
from dyknow.ros.process.programs import find_script
from dyknow.ros.scripts.modules import script_importer
from dyknow.ros.scripts.sandbox import HOOKS_PATIENCE, Sandbox, SandboxEnd
from dyknow.ros.scripts.script_ports import ScriptHandle

#: Seconds in which an error of the main thread makes the load fail, unless it waits before.
PATIENCE = 2.0

_log = logging.getLogger("rosout.dyknow")


class ScriptCode:
    """One script, ready to be executed once in a sandbox.

    ``argv`` is the command line, the path of the script first. The script calls ``init_node`` as
    ``rospy.init_node``, and has modules of the ``package`` of its own.

    Raises:
        CannotRun: the file cannot be read.
        SyntaxError: it is not Python.
    """

    def __init__(
        self,
        sandbox: Sandbox,
        argv: Sequence[str],
        init_node: Callable[..., None],
        package: str = "",
    ) -> None:
        self._sandbox = sandbox
        file = script_file(argv[0])
        sandbox.argv = [file, *argv[1:]]
        self.importer = script_importer(sandbox, file, argv[0], init_node, package)
        self.module = self.importer.prepare("__main__", file)
        try:
            with open(file, "rb") as source:
                self._code = compile(source.read(), file, "exec", dont_inherit=True)
        except OSError as error:
            raise CannotRun(f"'{file}' cannot be read: {error.strerror}") from error

    def execute(self) -> None:
        """Execute it, on the thread that is its main one."""
        exec(self._code, vars(self.module))

    def let_go(self) -> None:
        """Free all that its modules hold, unless a thread does not end."""
        self._sandbox.let_go()
        if not self.importer.clear():
            _log.info("%s: its memory is kept for the code that still runs", self._sandbox.name)


class ScriptNodelet(Nodelet):
    """Runs a script that is written for a process of its own: ``my_argv`` is its command line.

    Its first word is the script, as ``PACKAGE/SCRIPT``. Private parameter:
    ``~by_reference`` (false), whether it shares messages with its neighbours as nodelets do.
    """

    _sandbox: Sandbox | None = None
    _end: SandboxEnd | None = None
    _error: BaseException | None = None

    def bind(self, context: Context) -> None:
        context.executor = context.runtime.blocking  # callbacks may block: each has a thread
        super().bind(context)

    def on_init(self) -> None:
        """Run it until it waits for the first time, or has ended."""
        if not self.my_argv:
            raise CannotRun("expected the script as the first argument: PACKAGE/SCRIPT")
        argv = [find_script(self.my_argv[0]), *self.my_argv[1:]]
        by_reference = bool(self.private_node_handle.get_param("~by_reference", False))
        sandbox = self._sandbox = Sandbox(self.name, copies=not by_reference)
        sandbox.on_refusal = self._refused
        arguments = NodeArguments()

        def init_node(*args: Any, **kwds: Any) -> None:
            arguments.note(args, kwds)

        code = ScriptCode(sandbox, argv, init_node, self.my_argv[0].partition("/")[0])
        self._end = SandboxEnd(sandbox, code.importer.files)
        sandbox.main = threading.Thread(
            target=self._main, args=(sandbox, code), name=f"{self.name} main", daemon=True
        )
        self.context.close_with(self._end)
        self.context.last_hooks.append(code.let_go)
        sandbox.begin(ScriptHandle(self.mt_node_handle))
        sandbox.main.start()
        sandbox.settled.wait(PATIENCE)
        sandbox.settled.set()  # a later error is for the log
        error, self._error = self._error, None
        if error is not None:
            sandbox.closing.set()
            raise error

    def on_shutdown(self) -> None:
        """End it as the end of a process would."""
        if self._end is not None:
            self._end.in_order(HOOKS_PATIENCE)

    def _main(self, sandbox: Sandbox, code: ScriptCode) -> None:
        try:
            with self.context.executor.record.noting(self.context.mark):
                code.execute()
        except SystemExit as end:
            if end.code not in (None, 0):
                self._failed(sandbox, ScriptEnded(self.name, end.code))
        except BaseException as error:  # the boundary of the script
            self._failed(sandbox, error)
        sandbox.join()
        sandbox.settled.set()
        if not sandbox.closing.is_set():
            sandbox.unload("the script has ended")

    def _refused(self, refusal: NeedsProcess) -> None:
        """Give up a script that runs on without a thread or a callback of its own."""
        sandbox = self._sandbox
        assert sandbox is not None
        if not sandbox.closing.is_set():
            self._error = refusal
            sandbox.settled.set()
            sandbox.unload("the script has ended")

    def _failed(self, sandbox: Sandbox, error: BaseException) -> None:
        if sandbox.closing.is_set():
            return
        self._error = error  # first, so that the load has it if it is not for the log
        if sandbox.settled.is_set():
            lines = traceback.format_exception(type(error), error, error.__traceback__)
            _log.error("%s: the script has failed\n%s", self.name, "".join(lines))


class NodeArguments:
    """The arguments of ``rospy.init_node``; as in rospy, each call must have the same."""

    def __init__(self) -> None:
        self._args: Any = None

    def note(self, *args: Any) -> bool:
        """Note a call; returns whether it is the first.

        Raises:
            rospy.ROSException: an earlier one had other arguments.
        """
        before, self._args = self._args, self._args or args
        if before not in (None, args):
            raise rospy.ROSException(
                f"rospy.init_node() has already been called with different arguments: {before}"
            )
        return before is None
