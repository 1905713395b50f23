# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The services and topics of the DyKnow manager, over its methods and the reconciler's."""

from __future__ import annotations

import logging
import time
from typing import Any, Callable, Sequence

import genpy
import rospy
from dyknow_msgs import msg, srv

from dyknow.errors import BadParameter, DuplicatePort, DyKnowError, InvalidConfiguration
from dyknow.locks import turn_lock
from dyknow.manager.claim import ClaimEvent
from dyknow.manager.claims.answers import StreamAnswers, refusal_of, unknown_names
from dyknow.manager.claims.reconciler import StreamReconciler
from dyknow.manager.specifications.given import undeclared
from dyknow.manager.specifications.tags import written_bindings
from dyknow.model.graph import Model, SpawnRequest
from dyknow.model.hosts import AT
from dyknow.ros.hosting.installed import missing_here
from dyknow.ros.nodelets.process_guards import caller_of
from dyknow.ros.nodelets.proxy_services import for_log
from dyknow.ros.transport.registrar import services_together
from dyknow.ros.wire.messages import (
    acquire_from,
    acquisition_message,
    config_pairs,
    event_message,
    host_message,
    parameters_from,
    planned_message,
    refusal_message,
    replanned_message,
    stream_message,
)
from dyknow.ros.wire.model_messages import ModelMessages

#: Events that may wait for a slow subscriber.
_QUEUE_SIZE = 1000
#: Seconds between two messages of counts: a stream that stops is silent in one of them within 2 s.
_COUNTS_PERIOD = 0.8

_log = logging.getLogger("rosout.dyknow")


class ManagerServices:
    """The private services of the node; a handler returns the response, or None for success."""

    def __init__(
        self,
        reconciler: StreamReconciler,
        messages: ModelMessages,
        answers: StreamAnswers,
        after_change: Callable[[], None],
        publish: Callable[[], object],
    ) -> None:
        """Offer the services.

        ``after_change`` is called after each attempt to change something, before it is answered;
        then ``publish``, so that readers of the topic of the model see a change at once.
        """
        self._reconciler = reconciler
        self._manager = reconciler.manager
        self._messages = messages
        self._answers = answers
        self._after_change = after_change
        self._publish = publish
        self._services: list[Any] = []
        with services_together():
            self._offer_all()

    def close(self) -> None:
        """Withdraw the services."""
        while self._services:
            self._services.pop().shutdown("the manager ends")

    def _offer_all(self) -> None:
        self._offer(
            "add_transformation",
            srv.AddTransformation,
            self._add,
            lambda r: "adding transformations",
        )
        self._offer(
            "remove_transformation",
            srv.RemoveTransformation,
            self._remove,
            lambda r: f"removing transformation '{r.label}'",
        )
        self._offer(
            "spawn", srv.Spawn, self._spawn, lambda r: f"spawning '{r.name}' from '{r.label}'"
        )
        self._offer("destroy", srv.Destroy, self._destroy, lambda r: f"destroying '{r.name}'")
        self._offer(
            "set_protection",
            srv.SetProtection,
            self._set_protection,
            lambda r: f"{'protecting' if r.is_protected else 'releasing'} '{r.name}'",
        )
        self._offer("restart", srv.Restart, self._restart, lambda r: f"restarting '{r.name}'")
        self._offer(
            "set_parameter",
            srv.SetParameter,
            self._set_parameter,
            lambda r: f"setting parameter '{r.parameter.name}' of '{r.name}'",
        )
        self._offer(
            "connect",
            srv.Connect,
            self._connect,
            lambda r: f"connecting {', '.join(repr(each.nodelet) for each in r.nodelets)}",
        )
        self._offer(
            "acquire_stream",
            srv.AcquireStream,
            self._acquire,
            lambda r: f"{'planning' if r.dry_run else 'acquiring'} '{r.tag}'",
            lambda error: refusal_message(refusal_of(error)),
        )
        self._offer(
            "release_stream",
            srv.ReleaseStream,
            self._release,
            lambda r: f"releasing stream '{r.claim_id}'",
        )
        self._offer("renew_stream", srv.RenewStream, self._renew)  # too frequent for the log
        self._offer(
            "replan_stream",
            srv.ReplanStream,
            self._replan,
            lambda r: f"replanning stream '{r.claim_id}'",
        )
        self._offer("plan_stream", srv.PlanStream, self._plan)
        self._offer("list_streams", srv.ListStreams, self._list)
        self._offer("find_bindings", srv.FindBindings, self._find_bindings)
        self._offer("list_hosts", srv.ListHosts, self._list_hosts)
        # Last, since clients take a manager that answers it for one that is up.
        self._offer("get_model", srv.GetModel, self._get_model)

    def _offer(
        self,
        name: str,
        service_class: Any,
        handler: Callable[[Any], Any],
        what: Callable[[Any], str] | None = None,
        refused: Callable[[Exception], Any] | None = None,
    ) -> None:
        """Offer a service of a private name.

        ``what`` names a change in the log; a service without it changes nothing. ``refused`` makes
        the response of a request that failed.
        """
        response_class = service_class._response_class

        def work(request: Any) -> Any:
            self._check_sizes(request)
            return handler(request)

        def answer(request: Any) -> Any:
            try:
                done = self._logged(request, what(request), work) if what else work(request)
                response = response_class(success=True) if done is None else done
            except DyKnowError as error:
                if refused is not None:
                    return refused(error)
                return response_class(success=False, message=str(error))
            if getattr(response, "success", False) and not getattr(request, "dry_run", False):
                remark = self._manager.store.remark
                response.message = "\n".join(filter(None, (response.message, remark)))
            return response

        self._services.append(rospy.Service(f"~{name}", service_class, answer))

    def _logged(self, request: Any, what: str, handler: Callable[[Any], Any]) -> Any:
        what, caller = for_log(what), for_log(caller_of(request))
        try:
            try:
                response = handler(request)
            finally:
                self._after_change()
                self._publish()
        except DyKnowError as error:
            rospy.logwarn("%s for %s: refused: %s", what, caller, for_log(error))
            raise
        except Exception as error:  # the boundary of the service
            _log.exception("%s for %s failed", what, caller)
            raise DyKnowError(f"internal error: {type(error).__name__}: {error}") from error
        rospy.loginfo("%s for %s: done", what, caller)
        return response

    def _check_sizes(self, message: Any) -> None:
        """Refuse a request, or a message in one, with a text or an array beyond the limits."""
        for name in message.__slots__:
            if name == "specification":
                continue  # it has a limit of its own
            value = getattr(message, name)
            entries = value if isinstance(value, list) else [value]
            texts = [each for each in entries if isinstance(each, str)]
            self._manager.guards.check_sizes(texts, len(entries))
            for each in entries:
                if isinstance(each, genpy.Message):
                    self._check_sizes(each)

    # Transformations and nodelets

    def _add(self, request: Any) -> Any:
        found = self._manager.add_transformation(request.specification)
        labels = sorted({each.label for each in found.transformations})
        missing = missing_here("specification", found.transformations)
        remarks = map(str, (*found.warnings, *missing))
        return srv.AddTransformationResponse(True, "\n".join(remarks), labels)

    def _remove(self, request: Any) -> None:
        self._manager.remove_transformation(request.label)

    def _spawn(self, request: Any) -> Any:
        pairs = config_pairs(request.config)
        given = parameters_from(request.parameters)
        made = self._manager.spawn(
            SpawnRequest(
                request.label,
                request.name,
                _mapping(request.name, pairs),
                request.is_protected,
                request.isolated,
                self._place(request.manager),
                given,
            )
        )
        return srv.SpawnResponse(True, "\n".join(undeclared(made.transformation, given)))

    def _place(self, manager: str) -> str:
        """Make the name of a nodelet manager global, but not that of a host."""
        is_relative = manager and manager[:1] != AT
        return self._manager.resolve(manager) if is_relative else manager

    def _destroy(self, request: Any) -> None:
        self._manager.destroy(request.name)

    def _set_protection(self, request: Any) -> None:
        self._manager.set_protection(request.name, request.is_protected)

    def _restart(self, request: Any) -> Any:
        done = self._manager.restart(request.name)
        return srv.RestartResponse(True, done.remarks, list(done.names))

    def _set_parameter(self, request: Any) -> Any:
        (given,) = parameters_from([request.parameter])
        done = self._manager.set_parameter(request.name, given)
        return srv.SetParameterResponse(True, done.remarks, done.is_read)

    def _connect(self, request: Any) -> None:
        moves = [(each.nodelet, config_pairs(each.config)) for each in request.nodelets]
        self._manager.connect([(name, _mapping(name, pairs)) for name, pairs in moves])

    def _list_hosts(self, request: Any) -> Any:
        return srv.ListHostsResponse([host_message(each) for each in self._manager.hosts()])

    def _get_model(self, request: Any) -> Any:
        return self._messages.response(self._manager.get_model())

    # Streams

    def _acquire(self, request: Any) -> Any:
        wanted = acquire_from(request)
        acquired = self._reconciler.acquire(wanted, request.dry_run)
        unknown = unknown_names(self._manager, wanted)
        return acquisition_message(self._answers.acquisition(acquired, unknown))

    def _release(self, request: Any) -> None:
        self._manager.guards.check_writable(f"releasing '{request.claim_id}'")
        self._reconciler.release(request.claim_id)

    def _renew(self, request: Any) -> Any:
        lease = float(request.lease.to_sec())
        if lease < 0:
            expected = "seconds from 0 (which means: until released)"
            raise BadParameter("lease", f"{lease:g}", expected)
        claim = self._reconciler.renew(request.claim_id, lease)
        expires = rospy.Time.from_sec(self._answers.expires(claim))
        return srv.RenewStreamResponse(True, "", expires)

    def _replan(self, request: Any) -> Any:
        acquired = self._reconciler.replan(request.claim_id, request.dry_run)
        return replanned_message(self._answers.replanned(acquired))

    def _plan(self, request: Any) -> Any:
        acquired = self._reconciler.plan(request.claim_id, request.exclude)
        return planned_message(self._answers.replanned(acquired))

    def _list(self, request: Any) -> Any:
        claims = self._reconciler.claims()
        return srv.ListStreamsResponse([stream_message(self._answers.status(c)) for c in claims])

    def _find_bindings(self, request: Any) -> Any:
        found, are_all = self._reconciler.find_bindings(request.tag, request.datatype)
        message = "" if are_all else "there may be more: the search took too long"
        return srv.FindBindingsResponse(True, message, [written_bindings(each) for each in found])


def _mapping(name: str, pairs: Sequence[tuple[str, str]]) -> dict[str, str]:
    mapping = dict(pairs)
    if len(mapping) < len(pairs):
        ports = [port for port, _ in pairs]
        doubled = sorted({port for port in ports if ports.count(port) > 1})
        raise InvalidConfiguration(name, [DuplicatePort(port) for port in doubled])
    return mapping


class ModelTopic:
    """The latched topic of the model; one message may show several changes."""

    def __init__(
        self, take: Callable[[], Model], messages: ModelMessages, before: Callable[[], None]
    ) -> None:
        """Advertise the topic of the models that ``take`` returns; each comes after ``before``."""
        self._take = take
        self._messages = messages
        self._before = before
        self._shown: tuple[int, int] | None = None
        self._publisher = rospy.Publisher("~model", msg.Model, latch=True, queue_size=1)
        self._turn = turn_lock("model on its topic")
        self.close = self._publisher.unregister

    def publish(self) -> None:
        """Publish the present model, unless it was published."""
        with self._turn:
            self._before()
            model = self._take()
            revisions = (model.revision, model.library_revision)
            if revisions != self._shown:
                self._publisher.publish(self._messages.topic(model))
                self._shown = revisions


class CountsTopic:
    """The topic of the counts of messages; they are counted while there are subscribers."""

    def __init__(self, count: Callable[[], list[msg.NodeletCounts]]) -> None:
        """Advertise the topic; ``count`` asks the nodelets."""
        self._count = count
        #: A process that is asked twice at once answers once.
        self._turn = turn_lock("counts of messages")
        self._latest: tuple[float, list[msg.NodeletCounts]] = (0.0, [])
        self._publisher = rospy.Publisher("~counts", msg.Counts, queue_size=1)
        self.close = self._publisher.unregister

    def publish(self) -> float:
        """Publish the present counts; returns the seconds until the next."""
        if self._publisher.get_num_connections():
            with self._turn:
                found = self._count_now()
            self._publisher.publish(msg.Counts(found))
        return _COUNTS_PERIOD

    def latest(self) -> list[msg.NodeletCounts]:
        """Count the messages of all nodelets, unless that was just done."""
        with self._turn:
            began, found = self._latest
            return self._count_now() if time.monotonic() - began >= _COUNTS_PERIOD else found

    def _count_now(self) -> list[msg.NodeletCounts]:
        self._latest = time.monotonic(), self._count()
        return self._latest[1]


class EventTopic:
    """The topic of the events of claims, which are logged as well.

    It is withdrawn with the node, once the last event is sent.
    """

    def __init__(self, answers: StreamAnswers) -> None:
        self._answers = answers
        self._publisher = rospy.Publisher(
            "~stream_events", msg.StreamEvent, queue_size=_QUEUE_SIZE
        )

    def publish(self, event: ClaimEvent) -> None:
        """Publish an event."""
        claim = event.after
        tag, state = claim.request.tag, claim.state.name
        rospy.loginfo("stream %s, %s: %s: %s", claim.claim_id, tag, state, event.reason)
        self._publisher.publish(event_message(self._answers.event(event)))
