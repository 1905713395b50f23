"""The services about streams of the DyKnow manager, over the reconciler's methods."""

from __future__ import annotations

import logging
from typing import Any, Callable, List, Optional, Sequence, Tuple, Type

import rospy
from dyknow_msgs.srv import (
    AcquireStream,
    AcquireStreamResponse,
    ListStreams,
    ListStreamsResponse,
    ReleaseStream,
    ReleaseStreamResponse,
    RenewStream,
    RenewStreamResponse,
    ReplanStream,
    ReplanStreamResponse,
)

from dyknow.errors import (
    BadParameter,
    Denied,
    DyKnowError,
    InvalidTag,
    LimitExceeded,
    NoPlanFound,
    PeerTimeout,
    StreamTypeMismatch,
)
from dyknow.guards import Guards
from dyknow.manager.claim import Claim
from dyknow.manager.claims.reconciler import Acquired, StreamReconciler
from dyknow.manager.planning.explanation import as_tree
from dyknow.model.streams import StreamRequest
from dyknow.ros.log_text import for_log
from dyknow.ros.manager.remarks import with_remark
from dyknow.ros.manager.stream_messages import StreamMessages
from dyknow.ros.nodelets.guard_parameters import caller_of
from dyknow.ros.stream_views import with_warnings

_log = logging.getLogger("rosout.dyknow")

_RESULTS: Tuple[Tuple[Type[DyKnowError], int], ...] = (
    (NoPlanFound, AcquireStreamResponse.NO_PLAN),
    (InvalidTag, AcquireStreamResponse.INVALID_TAG),
    (StreamTypeMismatch, AcquireStreamResponse.TYPE_MISMATCH),
    (PeerTimeout, AcquireStreamResponse.TIMEOUT),
    (Denied, AcquireStreamResponse.DENIED),
    (LimitExceeded, AcquireStreamResponse.DENIED),
)


class StreamServices:
    """Offers the services until it is closed."""

    def __init__(
        self,
        reconciler: StreamReconciler,
        guards: Guards,
        messages: StreamMessages,
        after_change: Callable[[], None],
        remark: Callable[[], str],
        unknown_labels: Callable[[Sequence[str]], Sequence[str]],
    ) -> None:
        """Offer them.

        Args:
            reconciler: does it.
            guards: what nobody may do.
            messages: makes messages of claims.
            after_change: called after each attempt to change something, before it is answered.
            remark: what the answer to a change has to add; empty for nothing.
            unknown_labels: says which labels that a client excludes are those of nothing.
        """
        self._reconciler = reconciler
        self._guards = guards
        self._messages = messages
        self._after_change = after_change
        self._unknown_labels = unknown_labels
        self._services: List[Any] = [
            rospy.Service(name, service_class, with_remark(handler, remark))
            for name, service_class, handler in (
                ("~acquire_stream", AcquireStream, self._acquire),
                ("~release_stream", ReleaseStream, self._release),
                ("~renew_stream", RenewStream, self._renew),
                ("~replan_stream", ReplanStream, self._replan),
                ("~list_streams", ListStreams, self._list),
            )
        ]

    def close(self) -> None:
        """Withdraw them."""
        while self._services:
            self._services.pop().shutdown("the manager ends")

    def _acquire(self, request: Any) -> AcquireStreamResponse:
        answer = AcquireStreamResponse()

        def acquire() -> None:
            wanted = self._checked(request)
            acquired = self._reconciler.acquire(wanted, request.dry_run)
            claim = acquired.claim
            answer.claim_id, answer.topic = claim.claim_id, claim.topic
            answer.datatype = claim.datatype
            answer.message = with_warnings(claim.detail, self._unknown_labels(wanted.exclude))
            answer.expires = self._messages.expires(claim)
            _tell_plan(answer, acquired)

        what = f"{'planning' if request.dry_run else 'acquiring'} '{request.tag}'"
        error = self._try(request, what, acquire)
        answer.success = error is None
        if error is not None:
            answer.message = str(error)
            answer.result = _result(error)
            answer.claim_id = getattr(error, "claim_id", "")
        return answer

    def _release(self, request: Any) -> ReleaseStreamResponse:
        def release() -> None:
            self._guards.check_sizes([request.claim_id])
            self._guards.check_writable(f"releasing '{request.claim_id}'")
            self._reconciler.release(request.claim_id)

        error = self._try(request, f"releasing stream '{request.claim_id}'", release)
        return ReleaseStreamResponse(error is None, str(error or ""))

    def _renew(self, request: Any) -> RenewStreamResponse:
        """Renew a lease; it happens often, and is no news."""
        try:
            self._guards.check_sizes([request.claim_id])
            claim: Claim = self._reconciler.renew(request.claim_id, _lease(request))
        except DyKnowError as error:
            return RenewStreamResponse(False, str(error), rospy.Time())
        return RenewStreamResponse(True, "", self._messages.expires(claim))

    def _replan(self, request: Any) -> ReplanStreamResponse:
        answer = ReplanStreamResponse()

        def replan() -> None:
            self._guards.check_sizes([request.claim_id])
            acquired = self._reconciler.replan(request.claim_id, request.dry_run)
            answer.message = acquired.claim.detail
            _tell_plan(answer, acquired)

        error = self._try(request, f"replanning stream '{request.claim_id}'", replan)
        answer.success = error is None
        if error is not None:
            answer.message = str(error)
        return answer

    def _list(self, request: Any) -> ListStreamsResponse:
        return ListStreamsResponse(
            [self._messages.status(each) for each in self._reconciler.claims()]
        )

    def _checked(self, request: Any) -> StreamRequest:
        texts = (request.tag, request.datatype, request.client_id, request.request_id)
        self._guards.check_sizes(
            (*texts, request.bond_id, *request.exclude), entries=len(request.exclude)
        )
        if not 0 <= request.max_silence < float("inf"):
            raise BadParameter(
                "max_silence", f"{request.max_silence:g}", "seconds from 0 (which means: never)"
            )
        return StreamRequest(
            tag=request.tag,
            datatype=request.datatype,
            client_id=request.client_id,
            request_id=request.request_id,
            lease=_lease(request),
            max_silence=request.max_silence,
            exclude=tuple(sorted(set(request.exclude))),
            bond_id=request.bond_id,
        )

    def _try(self, request: Any, what: str, action: Callable[[], None]) -> Optional[Exception]:
        """Do what a request asks for; returns why it did not work."""
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


def _tell_plan(answer: Any, acquired: Acquired) -> None:
    answer.spawned = sorted(acquired.spawned)
    answer.reused = sorted(acquired.reused)
    if acquired.plan is not None:
        answer.cost = float(acquired.cost)
        answer.plan = as_tree(acquired.plan)


def _lease(request: Any) -> float:
    lease = float(request.lease.to_sec())
    if lease < 0:
        raise BadParameter("lease", f"{lease:g}", "seconds from 0 (which means: until released)")
    return lease


def _result(error: BaseException) -> int:
    """Number of the cause, which other errors may be wrapped around."""
    cause: Optional[BaseException] = error
    while cause is not None:
        for kind, number in _RESULTS:
            if isinstance(cause, kind):
                return number
        cause = cause.__cause__
    return int(AcquireStreamResponse.SPAWN_FAILED)
