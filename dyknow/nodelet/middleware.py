# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The seam between the runtime and ROS.

The runtime calls nothing of ROS itself: it is given a ``Middleware``. The real one is made by
``dyknow.ros.transport.middleware.rospy_middleware``, the public fake beside it is
``dyknow.nodelet.local``.

"Outside" means other processes, and ordinary rospy handles in this one: everything that the bus
does not reach by reference. A *registration* is an ordinary publisher or subscriber of ROS through
which the bus reaches the outside.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Callable, Dict, Sequence

from dyknow.errors import DyKnowError, HandleClosed

Receive = Callable[[Any], None]
Handler = Callable[[Any], Any]
Options = Dict[str, Any]

Converter = Callable[[Any, Any], Any]
"""Returns a message in the given class, which is one of its type."""

Parameter = Callable[[str, Any], Any]
"""Returns a parameter of a port by its name, or the given default."""

#: Stands for all subscribers of this process: among the peers of a publication they are one.
HERE: Any = object()
DIGEST_SIZE = 16  # bytes of the digest of a message


class Closable(ABC):
    """Something that is offered to ROS until it is closed."""

    __slots__ = ()

    @abstractmethod
    def close(self) -> None:
        """Withdraw it."""


@dataclass(frozen=True)
class Codec:
    """Another form of the messages of a port, which travels on a topic below that of the port."""

    form: str  # the last part of that topic's name, ``compressed`` of ``/image/compressed``
    datatype: Any  # class of the encoded messages
    encode: Callable[[Any], Any]  # returns the form of a message; any exception: it has none
    decode: Callable[[Any], Any]  # returns the message of an encoded form, likewise

    def decoding(self, receive: Receive) -> Receive:
        """Wrap ``receive`` so that it takes encoded messages."""
        return lambda message: receive(self.decode(message))


class OutsidePublisher(Closable):
    """The registration of one publication on one topic."""

    __slots__ = ("changed", "in_flight")

    #: Messages that its publication is just handing over; a switch waits for them too.
    in_flight: int
    #: To be called when ``peers`` have changed; None for no call.
    changed: Callable[[], None] | None
    #: Whether its publication must publish nothing now; ``bool()`` is False.
    is_fenced: Callable[[], bool] = bool

    @property
    @abstractmethod
    def heard(self) -> bool:
        """Whether there are subscribers; checked on every publish, so it must be quick."""

    @abstractmethod
    def peers(self) -> tuple[Any, ...]:
        """Subscribers outside: one for each process, ``HERE`` for rospy's own in this one."""

    @abstractmethod
    def publish(self, message: Any) -> None:
        """Serialise ``message`` once and send it to every subscriber outside."""

    @abstractmethod
    def publish_to(self, peer: Any, message: Any) -> None:
        """Send ``message`` to one of the ``peers``, unless that has left."""

    @abstractmethod
    def latch(self, message: Any) -> None:
        """Send ``message`` to every subscriber, and keep it for later ones."""

    @abstractmethod
    def wait(self, seconds: float) -> None:
        """Return when the outside subscribers of the topic are connected, or time is up."""

    @abstractmethod
    def drain(self, seconds: float) -> bool:
        """Wait until every published message was sent; False when time is up."""


class OutsideSubscriber(Closable):
    """The registration of one connection."""

    @abstractmethod
    def publishers(self) -> int:
        """Publishers that are connected; all of this process count as one."""

    def links(self) -> tuple[Any, ...]:
        """Connections to other processes, as the transport describes them."""
        return ()

    @abstractmethod
    def wait(self, arrived: Callable[[float], bool], seconds: float) -> None:
        """Return when messages flow from the outside publishers, or none are there, or time is up.

        ``arrived`` waits at most so many seconds for a first message, and returns if it came.
        """

    def wait_for_all(self, seconds: float) -> None:
        """Return when all outside publishers would send us a message, or time is up."""

    def missing(self) -> list[str]:
        """Addresses of publishers that answer, and did not send to us when a wait ended."""
        return []

    def hear(self, arrived: Callable[[float], bool], seconds: float) -> None:
        """Return when each publisher has sent a message, or time is up; ``arrived`` as above."""

    @abstractmethod
    def drain(self, seconds: float) -> None:
        """Drain the sockets, then stop reading; give up after ``seconds``."""


class Transport(ABC):
    """Topics outside, and the messages that travel on them."""

    @abstractmethod
    def advertise(
        self, topic: str, datatype: Any, latch: bool, queue_size: int | None, options: Options
    ) -> OutsidePublisher:
        """Register a publisher of a global topic name.

        A queue of ``queue_size`` messages is kept for each slow subscriber (None: the default);
        ``options`` are further arguments for ``rospy.Publisher``.
        """

    @abstractmethod
    def subscribe(
        self, topic: str, datatype: Any, receive: Receive, options: Options
    ) -> OutsideSubscriber:
        """Register a subscriber; ``receive`` gets every message from outside, on any thread."""

    @abstractmethod
    def datatype_of(self, topic: str) -> str:
        """Type of a topic that has a live publisher or subscriber anywhere, else empty."""

    @abstractmethod
    def is_published(self, topic: str) -> bool:
        """Whether a topic has a publisher anywhere; False if that cannot be found out now."""

    @abstractmethod
    def build(self, datatype: Any, args: Sequence[Any], kwds: dict[str, Any]) -> Any:
        """Make a message of the arguments of ``publish``, with rospy's rules and errors."""

    @abstractmethod
    def digest(self, message: Any) -> bytes:
        """Return ``DIGEST_SIZE`` bytes, the same in each process that receives the message."""

    @abstractmethod
    def pack(self, message: Any) -> bytes:
        """Serialise a message."""

    @abstractmethod
    def unpack(self, datatype: Any, content: bytes) -> Any:
        """Return the message that ``pack`` serialised."""

    def sample_of(self, message: Any) -> tuple[float | None, int]:
        """Seconds since the time stamp of a message, None without one, and its size in bytes.

        A size of 0 is not known. Quick, raises nothing.
        """
        return None, 0

    def codec(self, datatype: Any, parameter: Parameter) -> Codec | None:
        """Return the further form in which the messages of a port travel, if it is to have one.

        Raises:
            BadParameter: a parameter of the port is none that the form has, or has no such value.
        """
        return None

    def adapt(self, datatype: Any, receive: Receive) -> Receive:
        """Wrap ``receive`` so that it takes the messages of all publishers of this process.

        That is needed where ``datatype`` stands for "any type", or is a special class of its type.
        """
        return receive

    def converter(self, datatype: Any) -> Converter | None:
        """Return how subscribers of other classes take messages of a special class of a type."""
        return None


class Services(ABC):
    """Services that nodelets offer."""

    @abstractmethod
    def offer(
        self, service: str, service_class: Any, handler: Handler, options: Options, owner: str
    ) -> Closable:
        """Offer a service of the nodelet ``owner`` under a global name.

        ``handler`` is called on any thread.
        """


class Ticker(ABC):
    """The time that timers follow."""

    #: Least seconds from one look at the timers to the next.
    pause = 0.002

    @abstractmethod
    def now(self) -> float:
        """Seconds; steady, or simulated time when the system runs on it."""

    def has_begun(self, now: float) -> bool:
        """Whether time ran when it was ``now``; nothing is due before it does."""
        return True

    @abstractmethod
    def wait(self, until: float | None) -> None:
        """Return at ``until`` (None: never), after ``wake``, or earlier for no reason."""

    @abstractmethod
    def wake(self) -> None:
        """End the present or the next ``wait``."""

    @staticmethod
    def seconds_of(duration: Any) -> float:
        """Seconds of a ``rospy.Duration``; plain numbers are seconds already."""
        return float(duration.to_sec() if hasattr(duration, "to_sec") else duration)

    @abstractmethod
    def event(self, last: Any, expected: float, real: float, duration: Any) -> Any:
        """Make the event for a timer callback.

        ``last`` is the event before and ``duration`` the seconds that its callback took, both None
        at the first; the callback was due at ``expected`` and is called at ``real``.
        """


class Node(ABC):
    """The node of ROS that this process is; its exceptions take a message naming the operation."""

    closed: type[Exception] = HandleClosed  # of a closed handle
    interrupted: type[Exception] = DyKnowError  # of a wait or call whose nodelet is unloaded
    timed_out: type[Exception] = DyKnowError  # of a wait for a message that did not come in time

    @abstractmethod
    def is_shutdown(self) -> bool:
        """Whether the whole process is to end."""

    @abstractmethod
    def remap(self, name: str) -> str:
        """Apply the remappings of the process's command line to a global name."""

    @abstractmethod
    def member(self, name: str, handle: Any) -> Any:
        """Return the attribute ``name`` of a NodeHandle where DyKnow adds nothing to ROS.

        Raises:
            AttributeError: ROS has no such thing, or a nodelet must not use it.
        """


@dataclass(frozen=True)
class Middleware:
    """Everything that nodelets get from ROS and that is not done in this process."""

    transport: Transport
    services: Services
    ticker: Ticker
    node: Node
