# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The services of the DyKnow manager, over its methods and those of the reconciler."""

from __future__ import annotations

import logging
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

import rospy
from dyknow_msgs import srv

from dyknow.errors import BadParameter, DuplicatePort, DyKnowError, InvalidConfiguration
from dyknow.manager.claims.answers import StreamAnswers, refusal_of, unknown_labels
from dyknow.manager.claims.reconciler import StreamReconciler
from dyknow.manager.manager import Manager
from dyknow.manager.specifications.given import undeclared
from dyknow.manager.specifications.tags import written_bindings
from dyknow.model.graph import SpawnRequest
from dyknow.model.streams import StreamRequest
from dyknow.ros.hosting.installed import missing_here
from dyknow.ros.nodelets.guard_parameters import caller_of
from dyknow.ros.process.logs import for_log
from dyknow.ros.wire.messages import (
    acquire_from,
    acquisition_message,
    config_pairs,
    parameters_from,
    refusal_message,
    replanned_message,
    stream_message,
)
from dyknow.ros.wire.model_messages import ModelMessages

_log = logging.getLogger("rosout.dyknow")


class _Services:
    """Private services of the node, until they are closed together."""

    def __init__(self, manager: Manager, after_change: Callable[[], None]) -> None:
        self._manager = manager
        self._after_change = after_change
        self._services: List[Any] = []

    def close(self) -> None:
        """Withdraw the services."""
        while self._services:
            self._services.pop().shutdown("the manager ends")

    def _offer(self, name: str, service_class: Any, handler: Callable[[Any], Any]) -> None:
        def answer(request: Any) -> Any:
            response = handler(request)
            if getattr(response, "success", False) and not getattr(request, "dry_run", False):
                remark = self._manager.store.remark
                response.message = "\n".join(filter(None, (response.message, remark)))
            return response

        self._services.append(rospy.Service(f"~{name}", service_class, answer))

    def _attempt(
        self, request: Any, what: str, action: Callable[[], object]
    ) -> Optional[Exception]:
        """Call ``action``, and log it; returns why it failed, or None.

        Args:
            request: as it came.
            what: the operation, for the log.
            action: does it.
        """
        what, caller = for_log(what), for_log(caller_of(request))
        try:
            try:
                action()
            finally:
                self._after_change()
        except DyKnowError as error:
            rospy.logwarn("%s for %s: refused: %s", what, caller, for_log(error))
            return error
        except Exception as error:  # the boundary of the service
            _log.exception("%s for %s failed", what, caller)
            return DyKnowError(f"internal error: {type(error).__name__}: {error}")
        rospy.loginfo("%s for %s: done", what, caller)
        return None

    def _outcome(self, request: Any, what: str, action: Callable[[], object]) -> Tuple[bool, str]:
        """Call ``action`` likewise; returns the fields ``success`` and ``message``."""
        error = self._attempt(request, what, action)
        return error is None, str(error or "")

    def _check_sizes(self, *texts: str, entries: int = 0) -> None:
        self._manager.guards.check_sizes(texts, entries)


class ManagerServices(_Services):
    """Services for transformations and nodelets."""

    def __init__(
        self,
        manager: Manager,
        messages: ModelMessages,
        after_change: Callable[[], None],
        publish: Callable[[], None],
    ) -> None:
        """Offer the services.

        Args:
            manager: does the work.
            messages: makes the answers of get_model.
            after_change: called after each attempt to change something, before it is answered.
            publish: publishes the model, so that readers of its topic see a change at once.
        """
        super().__init__(manager, after_change)
        self._messages = messages
        self._publish = publish
        self._offer("add_transformation", srv.AddTransformation, self._add_transformation)
        self._offer("remove_transformation", srv.RemoveTransformation, self._remove)
        self._offer("spawn", srv.Spawn, self._spawn)
        self._offer("destroy", srv.Destroy, self._destroy)
        self._offer("set_protection", srv.SetProtection, self._set_protection)
        self._offer("connect", srv.Connect, self._connect)
        self._offer("get_model", srv.GetModel, self._get_model)

    def _add_transformation(self, request: Any) -> Any:
        labels: List[str] = []
        remarks: List[str] = []

        def add() -> None:
            found = self._manager.add_transformation(request.specification)
            labels.extend(sorted({each.label for each in found.transformations}))
            missing = missing_here("specification", found.transformations)
            remarks.extend(map(str, (*found.warnings, *missing)))

        done, why = self._outcome(request, "adding transformations", add)
        return srv.AddTransformationResponse(done, "\n".join(remarks) if done else why, labels)

    def _remove(self, request: Any) -> Any:
        def remove() -> None:
            self._check_sizes(request.label)
            self._manager.remove_transformation(request.label)

        what = f"removing transformation '{request.label}'"
        return srv.RemoveTransformationResponse(*self._outcome(request, what, remove))

    def _spawn(self, request: Any) -> Any:
        remarks: List[str] = []

        def spawn() -> None:
            pairs = config_pairs(request.config)
            given = parameters_from(request.parameters)
            texts = [text for entry in (*pairs, *given) for text in entry]
            self._check_sizes(
                request.label,
                request.name,
                request.manager,
                *texts,
                entries=max(len(pairs), len(given)),
            )
            manager = self._manager.resolve(request.manager) if request.manager else ""
            made = self._manager.spawn(
                SpawnRequest(
                    request.label,
                    request.name,
                    _mapping(request.name, pairs),
                    request.is_protected,
                    request.isolated,
                    manager,
                    given,
                )
            )
            remarks.extend(undeclared(made.transformation, given))

        what = f"spawning '{request.name}' from '{request.label}'"
        done, why = self._outcome(request, what, spawn)
        return srv.SpawnResponse(done, "\n".join(remarks) if done else why)

    def _destroy(self, request: Any) -> Any:
        def destroy() -> None:
            self._check_sizes(request.name)
            self._manager.destroy(request.name)

        what = f"destroying '{request.name}'"
        return srv.DestroyResponse(*self._outcome(request, what, destroy))

    def _set_protection(self, request: Any) -> Any:
        def protect() -> None:
            self._check_sizes(request.name)
            self._manager.set_protection(request.name, request.is_protected)

        what = f"{'protecting' if request.is_protected else 'releasing'} '{request.name}'"
        return srv.SetProtectionResponse(*self._outcome(request, what, protect))

    def _connect(self, request: Any) -> Any:
        def connect() -> None:
            moves = [(each.nodelet, config_pairs(each.config)) for each in request.nodelets]
            texts = [
                text for name, pairs in moves for entry in ((name,), *pairs) for text in entry
            ]
            self._check_sizes(*texts, entries=max([len(moves), *(len(p) for _, p in moves)]))
            self._manager.connect([(name, _mapping(name, pairs)) for name, pairs in moves])
            self._publish()

        what = f"connecting {', '.join(repr(each.nodelet) for each in request.nodelets)}"
        return srv.ConnectResponse(*self._outcome(request, what, connect))

    def _get_model(self, request: Any) -> Any:
        return self._messages.response(self._manager.get_model())


class StreamServices(_Services):
    """Services for streams."""

    def __init__(
        self,
        manager: Manager,
        reconciler: StreamReconciler,
        answers: StreamAnswers,
        after_change: Callable[[], None],
    ) -> None:
        """Offer the services.

        Args:
            manager: has the guards, the store and the library.
            reconciler: does the work.
            answers: converts claims for clients.
            after_change: called after each attempt to change something, before it is answered.
        """
        super().__init__(manager, after_change)
        self._reconciler = reconciler
        self._answers = answers
        self._offer("acquire_stream", srv.AcquireStream, self._acquire)
        self._offer("release_stream", srv.ReleaseStream, self._release)
        self._offer("renew_stream", srv.RenewStream, self._renew)
        self._offer("replan_stream", srv.ReplanStream, self._replan)
        self._offer("list_streams", srv.ListStreams, self._list)
        self._offer("find_bindings", srv.FindBindings, self._find_bindings)

    def _acquire(self, request: Any) -> Any:
        answers: List[Any] = []

        def acquire() -> None:
            wanted = self._checked(request)
            acquired = self._reconciler.acquire(wanted, request.dry_run)
            unknown = unknown_labels(self._manager, wanted.exclude) if wanted.exclude else ()
            answers.append(acquisition_message(self._answers.acquisition(acquired, unknown)))

        what = f"{'planning' if request.dry_run else 'acquiring'} '{request.tag}'"
        error = self._attempt(request, what, acquire)
        return answers[0] if error is None else refusal_message(refusal_of(error))

    def _release(self, request: Any) -> Any:
        def release() -> None:
            self._check_sizes(request.claim_id)
            self._manager.guards.check_writable(f"releasing '{request.claim_id}'")
            self._reconciler.release(request.claim_id)

        what = f"releasing stream '{request.claim_id}'"
        return srv.ReleaseStreamResponse(*self._outcome(request, what, release))

    def _renew(self, request: Any) -> Any:
        """Renew a lease (not logged: too frequent)."""
        try:
            self._check_sizes(request.claim_id)
            lease = float(request.lease.to_sec())
            if lease < 0:
                expected = "seconds from 0 (which means: until released)"
                raise BadParameter("lease", f"{lease:g}", expected)
            claim = self._reconciler.renew(request.claim_id, lease)
        except DyKnowError as error:
            return srv.RenewStreamResponse(False, str(error), rospy.Time())
        expires = rospy.Time.from_sec(self._answers.expires(claim))
        return srv.RenewStreamResponse(True, "", expires)

    def _replan(self, request: Any) -> Any:
        answers: List[Any] = []

        def replan() -> None:
            self._check_sizes(request.claim_id)
            acquired = self._reconciler.replan(request.claim_id, request.dry_run)
            answers.append(replanned_message(self._answers.replanned(acquired)))

        error = self._attempt(request, f"replanning stream '{request.claim_id}'", replan)
        if error is not None:
            return srv.ReplanStreamResponse(success=False, message=str(error))
        return answers[0]

    def _list(self, request: Any) -> Any:
        claims = self._reconciler.claims()
        return srv.ListStreamsResponse([stream_message(self._answers.status(c)) for c in claims])

    def _find_bindings(self, request: Any) -> Any:
        try:
            self._check_sizes(request.tag, request.datatype)
            found, are_all = self._reconciler.find_bindings(request.tag, request.datatype)
        except DyKnowError as error:
            return srv.FindBindingsResponse(False, str(error), [])
        message = "" if are_all else "there may be more: the search took too long"
        return srv.FindBindingsResponse(True, message, [written_bindings(each) for each in found])

    def _checked(self, request: Any) -> StreamRequest:
        names = (*request.exclude, *request.prefer, *request.avoid)
        self._check_sizes(
            request.tag,
            request.datatype,
            request.client_id,
            request.request_id,
            request.bond_id,
            *names,
            entries=len(names),
        )
        return acquire_from(request)


def _mapping(name: str, pairs: Sequence[Tuple[str, str]]) -> Dict[str, str]:
    mapping = dict(pairs)
    if len(mapping) < len(pairs):
        ports = [port for port, _ in pairs]
        doubled = sorted({port for port in ports if ports.count(port) > 1})
        raise InvalidConfiguration(name, [DuplicatePort(port) for port in doubled])
    return mapping
