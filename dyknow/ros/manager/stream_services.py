"""The services about streams of the DyKnow manager, over the reconciler's methods."""

from __future__ import annotations

import logging
from typing import Any, Callable, List, Optional, Sequence

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
    DyKnowError,
)
from dyknow.guards import Guards
from dyknow.manager.claim import Claim
from dyknow.manager.claims.answers import StreamAnswers, refusal_of
from dyknow.manager.claims.reconciler import StreamReconciler
from dyknow.model.streams import StreamRequest
from dyknow.ros.log_text import for_log
from dyknow.ros.manager.remarks import with_remark
from dyknow.ros.messages import (
    acquire_from,
    acquisition_message,
    refusal_message,
    replanned_message,
    stream_message,
)
from dyknow.ros.nodelets.guard_parameters import caller_of

_log = logging.getLogger("rosout.dyknow")


class StreamServices:
    """Offers the services until it is closed."""

    def __init__(
        self,
        reconciler: StreamReconciler,
        guards: Guards,
        answers: StreamAnswers,
        after_change: Callable[[], None],
        remark: Callable[[], str],
        unknown_labels: Callable[[Sequence[str]], Sequence[str]],
    ) -> None:
        """Offer them.

        Args:
            reconciler: does it.
            guards: what nobody may do.
            answers: makes what clients are shown of claims.
            after_change: called after each attempt to change something, before it is answered.
            remark: what the answer to a change has to add; empty for nothing.
            unknown_labels: says which labels that a client excludes are those of nothing.
        """
        self._reconciler = reconciler
        self._guards = guards
        self._answers = answers
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
        answers: List[AcquireStreamResponse] = []

        def acquire() -> None:
            wanted = self._checked(request)
            acquired = self._reconciler.acquire(wanted, request.dry_run)
            warnings = self._unknown_labels(wanted.exclude)
            answers.append(acquisition_message(self._answers.acquisition(acquired, warnings)))

        what = f"{'planning' if request.dry_run else 'acquiring'} '{request.tag}'"
        error = self._try(request, what, acquire)
        return answers[0] if error is None else refusal_message(refusal_of(error))

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
        return RenewStreamResponse(True, "", rospy.Time.from_sec(self._answers.expires(claim)))

    def _replan(self, request: Any) -> ReplanStreamResponse:
        answers: List[ReplanStreamResponse] = []

        def replan() -> None:
            self._guards.check_sizes([request.claim_id])
            acquired = self._reconciler.replan(request.claim_id, request.dry_run)
            answers.append(replanned_message(self._answers.replanned(acquired)))

        error = self._try(request, f"replanning stream '{request.claim_id}'", replan)
        return answers[0] if error is None else ReplanStreamResponse(False, str(error))

    def _list(self, request: Any) -> ListStreamsResponse:
        return ListStreamsResponse(
            [stream_message(self._answers.status(each)) for each in self._reconciler.claims()]
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
        _lease(request)
        return acquire_from(request)

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


def _lease(request: Any) -> float:
    lease = float(request.lease.to_sec())
    if lease < 0:
        raise BadParameter("lease", f"{lease:g}", "seconds from 0 (which means: until released)")
    return lease
