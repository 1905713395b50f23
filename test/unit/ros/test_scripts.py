# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Scripts in a shared nodelet manager end, fail, log and have ports as in their own process."""

from __future__ import annotations

import gc
import logging
import threading
import weakref
from types import SimpleNamespace
from typing import Any

import pytest
import rospy
from clocks import PATIENCE, eventually, in_thread, join, wait_for
from rospy import SubscribeListener
from unit.nodelet.fakes import AnyMessage, Message, OtherMessage, World, numbers

from dyknow import names
from dyknow.errors import InvalidConfiguration, LoadFailed, PortConflict
from dyknow.nodelet.handle import PlainNodeHandle
from dyknow.proxy.handle import NodeHandle
from dyknow.ros.scripts import sandbox as sandbox_module
from dyknow.ros.scripts import script as script_module
from dyknow.ros.scripts.rospy_view import rospy_views
from dyknow.ros.scripts.sandbox import Sandbox
from dyknow.ros.scripts.script_ports import ScriptHandle, ScriptProxy
from dyknow.ros.transport.node import RospyNode


class TestTheEnd:
    THREAD = """
import threading, time
def work():
    for _ in range(20):
        time.sleep(0.002)
    script_witness.ended.set()
threading.Thread(target=work).start()
"""
    TIMERS = """
import threading
def tick(left):
    if left:
        threading.Timer(0.002, tick, (left - 1,)).start()
    else:
        script_witness.ended.set()
tick(5)
"""

    @pytest.mark.parametrize("text", [THREAD, TIMERS], ids=["thread", "timers"])
    def test_it_is_that_of_the_last_thread_that_is_no_daemon(self, scripts, text):
        scripts.load(text)
        wait_for(scripts.witness.ended)
        scripts.is_gone()

    def test_daemons_are_not_waited_for(self, scripts):
        wait = "threading.Thread(target=lambda: time.sleep(1000.0), daemon=True).start()"
        scripts.load(f"import threading, time\n{wait}")
        scripts.is_gone()

    def test_threads_of_callbacks_are_daemons_as_those_are(self):
        sandbox, found = Sandbox("/sandbox"), []
        thread = threading.Thread(target=lambda: found.append(sandbox.is_on_daemon()), daemon=True)
        thread.start()
        join(thread)
        assert found == [True]

    def test_a_late_failure_is_in_the_log(self, scripts, monkeypatch, caplog):
        monkeypatch.setattr(script_module, "PATIENCE", 0.01)
        wait = "while not script_witness.go_on.is_set(): pass"
        with caplog.at_level(logging.ERROR, "rosout.dyknow"):
            scripts.load(f"{wait}\nraise ValueError('no camera')")
            scripts.witness.go_on.set()
            scripts.is_gone()
        assert "ValueError: no camera" in caplog.text

    def test_a_script_that_shuts_down_during_its_load_is_loaded_and_then_gone(self, scripts):
        scripts.load("rospy.signal_shutdown('enough')\nscript_witness.go_on.wait(0.5)")
        scripts.is_gone()

    def test_a_hook_may_join_a_thread_that_asks_for_the_end_too(self):
        sandbox, ended = Sandbox("/sandbox"), []

        def hook():
            thread = in_thread(lambda: sandbox.signal_shutdown("a serial error"))
            thread.join(PATIENCE)
            ended.append(not thread.is_alive())

        sandbox.hooks.append(hook)
        sandbox.signal_shutdown("the end")
        assert ended == [True]

    def test_threads_that_have_not_started_are_not_forgotten(self, monkeypatch):
        monkeypatch.setattr(sandbox_module, "_MANY", 2)
        sandbox, threads = Sandbox("/sandbox"), [threading.Thread() for _ in range(5)]
        for thread in threads:
            sandbox.adopt(thread)
        assert sandbox.threads == threads


def test_a_parameter_that_is_read_is_no_wait_that_ends_the_load():
    """Or a script without a parameter that it needs would count as loaded."""
    sandbox: Any = Sandbox("/script", main=threading.current_thread())
    sandbox.begin(SimpleNamespace(get_param=str))
    view = rospy_views(sandbox, lambda: None, lambda: rospy)["rospy"]()
    assert view.get_param("~rate") == "~rate"
    assert not sandbox.settled.is_set()


class TestWhatConcernsTheProcess:
    @pytest.mark.parametrize(
        "text",
        [
            "import os\nos.execlp('true', 'true')",
            "import os\nos.execvpe('true', ['true'], {})",
            "import multiprocessing\nclass Own(multiprocessing.Process): pass",
            "import multiprocessing\nmultiprocessing.Process()",
        ],
    )
    def test_is_refused_with_the_cure(self, scripts, text):
        with pytest.raises(LoadFailed, match="a process of its own; spawn it isolated"):
            scripts.load(text)

    @pytest.mark.parametrize(
        "text",
        [
            "input()",
            "import sys\nfor line in sys.stdin: pass",
            "import sys\nwith sys.stdin: pass",
        ],
    )
    def test_a_keyboard_is_where_a_terminal_is(self, scripts, text):
        """A process that the manager starts has none either."""
        with pytest.raises(LoadFailed, match="needs a terminal; run it in one with 'dyknow run'"):
            scripts.load(text)

    @pytest.mark.parametrize(
        "text",
        [
            "import signal\nsignal.raise_signal(signal.SIGTERM)",
            "import os\nos.killpg(os.getpgrp(), 15)",
            "import os\nos.kill(0, 15)",
        ],
    )
    def test_signals_to_itself_end_the_script_alone(self, scripts, text):
        scripts.load(f"{text}\nrospy.spin()")
        scripts.is_gone()

    @pytest.mark.parametrize(
        ("end", "called"),
        [
            ("", []),
            ("rospy.signal_shutdown('enough')", []),
            ("signal.raise_signal(signal.SIGINT)\nrospy.spin()", [2]),
            ("script_witness.entered.set()\nrospy.spin()", [2]),
        ],
    )
    def test_one_handler_is_called_if_a_signal_would_have_come(self, scripts, end, called):
        scripts.witness.calls = []
        scripts.load(
            "import atexit, signal\natexit.register(script_witness.exited.set)\n"
            "def stop(number, frame): script_witness.calls.append(number)\n"
            "for each in (signal.SIGTERM, signal.SIGINT): signal.signal(each, stop)\n" + end
        )
        if scripts.witness.entered.is_set():
            scripts.unload()
        wait_for(scripts.witness.exited)
        assert scripts.witness.calls == called

    STOP = """
import atexit, signal, threading, time
never = threading.Event()
def stop(*unused):
    for _ in range(3):
        time.sleep(1000.0)
    script_witness.entered.set()
    for _ in range(3):
        never.wait()
    worker.join()
    script_witness.ended.set()
worker = threading.Thread(target=script_witness.go_on.wait)
worker.start()
"""

    @pytest.mark.parametrize(
        "how",
        [
            "atexit.register(stop)",
            "signal.signal(signal.SIGINT, stop)",
            "rospy.core.add_shutdown_hook(stop)",
        ],
    )
    def test_every_sleep_and_wait_of_its_last_functions_returns(self, scripts, caplog, how):
        scripts.load(f"{self.STOP}{how}\nrospy.spin()")
        scripts.unload()
        wait_for(scripts.witness.ended)
        assert "raised" not in caplog.text

    def test_a_last_function_that_sleeps_for_ever_is_ended(self, scripts):
        scripts.load(
            "import atexit, time\natexit.register(script_witness.exited.set)\n"
            "@atexit.register\ndef wait():\n    while True: time.sleep(0.1)"
        )
        wait_for(scripts.witness.exited)

    def test_an_interrupt_that_python_would_raise_is_no_failure(self, scripts, caplog):
        interrupt = "signal.signal(signal.SIGINT, signal.default_int_handler)"
        scripts.load(f"import signal\n{interrupt}\nrospy.spin()")
        scripts.unload()
        assert "KeyboardInterrupt" not in caplog.text

    def test_its_command_line_and_path_are_its_own(self, scripts, tmp_path):
        (tmp_path / "below").mkdir()
        (tmp_path / "below" / "beside.py").write_text("number = 5\n")
        scripts.load(
            "import os, sys\n"
            "sys.path = [os.path.join(os.path.dirname(__file__), 'below')] + sys.path\n"
            "import beside\n"
            "sys.argv = ['program', 'word', 'a:=b']\n"
            "script_witness.found = beside.number, rospy.myargv()"
        )
        assert scripts.witness.found == (5, ["program", "word"])
        scripts.is_gone()

    def test_what_it_prints_goes_to_the_output_that_it_has_set(self, scripts, capfd):
        scripts.load(
            "import io, sys\n"
            "print('first')\n"
            "sys.stdout = io.StringIO()\n"
            "print('second', 'word', sep='-')\n"
            "print('third', file=sys.stderr)\n"
            "script_witness.found = sys.stdout.getvalue()"
        )
        assert scripts.witness.found == "second-word\n"
        assert capfd.readouterr().out == "first\n"

    @pytest.mark.parametrize("kind", ["Thread(target=fail)", "Timer(0.0, fail)"])
    def test_its_hook_has_what_its_threads_raise(self, scripts, kind):
        scripts.load(
            "import threading\n"
            "def fail(): raise ValueError('no camera')\n"
            "def note(failed): script_witness.found = failed\n"
            f"threading.excepthook = note\nthread = threading.{kind}\n"
            "thread.start()\nthread.join()\nscript_witness.thread = thread"
        )
        eventually(lambda: hasattr(scripts.witness, "thread"))  # it is loaded when it waits
        kind, error, trace, thread = scripts.witness.found
        assert (kind, str(error), thread) == (ValueError, "no camera", scripts.witness.thread)
        assert trace is not None
        del scripts.witness.found, scripts.witness.thread

    def test_messages_bring_no_command_line_of_the_process_along(self, scripts):
        """Modules of message types have no ``__all__``, and import ``sys``."""
        scripts.load(
            "import sys\n"
            "from std_msgs.msg import *\n"
            "script_witness.found = String()._type, *sys.argv"
        )
        assert scripts.witness.found == ("std_msgs/String", str(scripts.folder / "script.py"))


def test_modules_of_its_package_are_those_on_disk(scripts, tmp_path, monkeypatch):
    package = tmp_path / "src" / "own_package"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    monkeypatch.syspath_prepend(str(package.parent))
    monkeypatch.setattr(script_module, "find_script", lambda word: str(tmp_path / "script.py"))
    for gain in (1, 200):
        (package / "algo.py").write_text(f"GAIN = {gain}\n")
        text = "from own_package.algo import GAIN\nscript_witness.found = GAIN"
        scripts.load(text, word="own_package/script.py")
        scripts.is_gone()
        assert scripts.witness.found == gain


@pytest.mark.parametrize("is_script", [True, False])
def test_each_instance_has_its_own_log_of_what_was_said_once(caplog, monkeypatch, is_script):
    monkeypatch.setattr(rospy.rostime, "_rostime_initialized", True)
    views: list[Any] = [
        rospy_views(Sandbox(name), lambda: None, lambda: rospy)["rospy"]() for name in ("/a", "/b")
    ]
    if not is_script:
        world = World()
        world.runtime.node = RospyNode()
        views = [world.handle("/a"), world.handle("/b")]
    with caplog.at_level(logging.WARNING, "rosout"):
        for view in views * 2:
            view.logwarn_once("no calibration")
            view.logwarn_throttle_identical(1000.0, "no lens")
    said = [(each.name, each.getMessage(), each.filename) for each in caplog.records]
    assert said == [
        (f"rosout.{name}", text, "test_scripts.py")
        for name in "ab"
        for text in ("no calibration", "no lens")
    ]


# Scripts are freed without garbage collection


BLOCK = """
import threading
from std_msgs.msg import Header
from std_srvs.srv import Empty
block = set()
script_witness.refer(block)
"""
SCRIPTS = {
    "global": "rospy.spin()",
    "object with a callback": """
class Node:
    def __init__(self):
        self.block = block
        self.sub = rospy.Subscriber("in", Header, self.receive)
        self.service = rospy.Service("service", Empty, self.receive)
        self.timer = rospy.Timer(rospy.Duration(0.01), self.receive)
        rospy.on_shutdown(self.end)
    def receive(self, message):
        pass
    def end(self):
        pass
def main():
    node = Node()
    rospy.spin()
main()
""",
    "thread": """
def work():
    mine = block
    while not rospy.is_shutdown():
        rospy.sleep(0.01)
threading.Thread(target=work).start()
""",
    "callback in a list": """
received = []
def receive(message, more):
    received.append(message)
sub = rospy.Subscriber("in", Header, receive, callback_args=received)
rospy.spin()
""",
}
LATE = """
def work():
    script_witness.go_on.wait()
    script_witness.found = block is not None
threading.Thread(target=work).start()
rospy.spin()
"""


@pytest.fixture
def block(scripts):
    """Refers weakly to the `block` of the script that was loaded last."""
    blocks = []
    scripts.witness.refer = lambda block: blocks.append(weakref.ref(block))
    gc.collect()
    gc.disable()
    yield lambda: blocks[-1]()
    gc.enable()


@pytest.mark.parametrize("kind", SCRIPTS)
def test_an_unload_frees_a_script_and_so_does_its_failure(scripts, block, kind):
    scripts.load(BLOCK + SCRIPTS[kind])
    assert block() is not None
    scripts.unload()
    eventually(lambda: block() is None)
    with pytest.raises(LoadFailed):
        scripts.load(BLOCK + "raise RuntimeError('injected')")
    eventually(lambda: block() is None)


def test_a_thread_that_does_not_end_keeps_its_modules(scripts, block):
    scripts.load(BLOCK + LATE)
    scripts.unload()
    assert block() is not None
    scripts.witness.go_on.set()
    eventually(lambda: getattr(scripts.witness, "found", False))


# Ports of scripts that make their subscribers late


class Script:
    """A script whose load names the topic `image`."""

    def __init__(self, **others):
        self.world = World()
        remappings = {"/robot/image": "/robot/script/disconnected/image", **others}
        context = self.world.context("/robot/script", remappings=remappings)
        self.handle = ScriptHandle(PlainNodeHandle(context, "/robot"))
        self.proxy = ScriptProxy.of(context)
        self.handle.Publisher("out", Message)

    def ports(self):
        return {port.name: (port.datatype, port.topic) for port in self.proxy.get_config()}


@pytest.fixture(name="script")
def _script():
    return Script()


def test_a_port_to_come_is_connected_when_it_comes(script):
    assert script.ports() == {"out": ("test/Message", "/robot/out")}
    script.proxy.set_config([("image", "/cam")])
    assert script.ports()["image"] == ("", "/cam")
    script.proxy.set_config([("/robot/image", "/cam2")])
    got = []
    script.handle.Subscriber("image", Message, got.append)
    assert script.ports()["image"] == ("test/Message", "/cam2")
    script.world.handle().Publisher("/cam2", Message).publish(1)
    script.world.drain()
    assert numbers(got) == [1]


@pytest.mark.parametrize(
    ("called", "name"),
    [
        ("/robot/image", "image"),
        ("image", "/robot/image"),
        ("/tf", "/tf"),
        ("~info", "/robot/script/info"),
        ("~info", "script/info"),
        ("script/info", "~info"),
        ("script/info", "/robot/script/info"),
    ],
)
def test_it_is_called_as_the_script_calls_its_topic(called, name):
    """Whichever of the topic's names its move had."""
    script = Script(**{"/tf": "/start", "/robot/script/info": "/start"})
    script.proxy.set_config([(names.resolve(name, "/robot", "/robot/script"), "/moved")])
    script.proxy.set_config([(name, "/cam")])
    assert len(script.ports()) == 2
    script.handle.Subscriber(called, Message, print)
    out = ("test/Message", "/robot/out")
    assert script.ports() == {"out": out, called: ("test/Message", "/cam")}


def test_it_may_turn_out_to_be_an_out_port(script):
    script.proxy.set_config([("image", "/cam")])
    script.handle.Publisher("image", Message)
    assert script.ports()["image"] == ("test/Message", "/cam")
    script.handle.Subscriber("image", Message, print)
    assert sorted(script.ports()) == ["image_in", "image_out", "out"]
    for name in ("image", "/robot/image"):
        with pytest.raises(InvalidConfiguration, match="known ports: image_in, image_out, out"):
            script.proxy.set_config([(name, "/cam")])


@pytest.mark.parametrize("name", ["imag", "/image", "a b", "~image", ""])
def test_what_no_load_names_is_unknown(script, name):
    with pytest.raises(InvalidConfiguration, match="unknown port"):
        script.proxy.set_config([(name, "/cam")])
    assert list(script.ports()) == ["out"]


@pytest.mark.parametrize("kind", [NodeHandle, ScriptHandle])
@pytest.mark.parametrize(
    ("port", "near"),
    [
        ("imge", "image"),
        ("~image", "image"),
        ("info", "~info"),
        ("/info", "~info"),
        ("image_", "image"),
        ("cam/imge", "cam/image"),
    ],
)
def test_a_misspelt_port_is_refused_with_the_right_one(kind, port: str, near: str) -> None:
    """In nodelets, and in scripts in a nodelet manager or in a process of their own."""
    context = World().context("/robot/n", remappings={"/robot/image": "/x"})
    handle = kind(PlainNodeHandle(context, "/robot"))
    for name in ("image", "cam/image"):
        handle.Subscriber(name, Message, print)
    handle.Publisher("~info", Message)
    proxy = kind.proxy_class.of(context)
    before = proxy.get_config()
    with pytest.raises(InvalidConfiguration) as error:
        proxy.set_config([("image", "/y"), (port, "/z")])
    assert f"unknown port '{port}'; known ports: cam/image, image, ~info; " in str(error.value)
    hints = str(error.value).split("did you mean ")[1].rstrip("?").split(" or ")
    assert near in hints
    assert proxy.get_config() == before


@pytest.mark.parametrize("maker", ["Publisher", "Subscriber"])
def test_what_the_load_misspells_is_unknown(script, maker):
    getattr(script.handle, maker)("~image", Message, None)
    with pytest.raises(InvalidConfiguration, match="did you mean ~image"):
        script.proxy.set_config([("image", "/cam")])
    assert sorted(script.ports()) == ["out", "~image"]


def test_a_lazy_script_may_have_both():
    """Either its load names both, or it watches its subscribers."""
    named = Script(**{"/robot/script/image": "/x"})
    named.handle.Publisher("~image", Message)
    watching = Script()
    watching.handle.Publisher("~image", Message, subscriber_listener=SubscribeListener())
    for script in (named, watching):
        script.proxy.set_config([("image", "/cam")])
        assert script.ports()["image"] == ("", "/cam")


def test_names_below_a_tilde_and_a_slash_are_global_as_in_rospy(script):
    handle, node = script.handle, script.world.node
    for maker in ("Publisher", "Subscriber"):
        getattr(handle, maker)(f"~/cam/{maker}", Message, None)
        assert script.ports()[f"/cam/{maker}"] == ("test/Message", f"/cam/{maker}")
    handle.set_param("~/rate", 5)
    assert node.parameters == {"/rate": 5}
    assert handle.tell_name("~/told") == "/told"
    handle.Publisher("/told", Message)
    assert "/told" in script.ports()
    assert handle.Service("~/obey", print, print).resolved_name == "/obey"


def test_a_port_by_a_longer_name(script):
    script.handle.Publisher("~out", Message)
    script.proxy.set_config([("script/out", "/x")])
    assert script.ports()["~out"] == ("test/Message", "/x")
    assert "script/out" not in script.ports()


@pytest.mark.parametrize("port", ["out", "image"])
def test_a_port_by_two_of_its_names_is_named_twice(script, port):
    with pytest.raises(InvalidConfiguration, match=f"port '{port}' is named twice"):
        script.proxy.set_config([(port, "/x"), (f"/robot/{port}", "/y")])


def test_a_refused_configuration_makes_no_port(script):
    before = script.proxy.get_config()
    with pytest.raises(InvalidConfiguration, match="known ports: out"):
        script.proxy.set_config([("image", "/cam"), ("nose", "/x")])
    assert script.proxy.get_config() == before


@pytest.mark.parametrize("maker", ["Publisher", "Subscriber"])
def test_a_port_that_the_script_has_let_go_of_may_get_another_type(script, maker):
    make = getattr(script.handle, maker)
    make("words", OtherMessage, None).unregister()
    make("words", Message, None)
    assert script.ports()["words"] == ("test/Message", "/robot/words")
    with pytest.raises(PortConflict, match="a port of type test/OtherMessage"):
        make("words", OtherMessage, None)


def test_a_subscriber_to_any_type_goes_with_one_of_a_type(script):
    got, any_type = [], []
    for datatype, received in ((AnyMessage, any_type), (Message, got), (AnyMessage, any_type)):
        script.handle.Subscriber("words", datatype, received.append)
    assert script.ports()["words"] == ("test/Message", "/robot/words")
    script.world.handle().Publisher("/robot/words", Message).publish(1)
    script.world.drain()
    assert numbers(got) == [1]
