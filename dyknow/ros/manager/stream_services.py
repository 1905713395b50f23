# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The services about streams of the DyKnow manager, over the reconciler's methods."""

from __future__ import annotations

from typing import Any, Callable, List, Sequence

import rospy
from dyknow_msgs.srv import (
    AcquireStream,
    AcquireStreamResponse,
    FindBindings,
    FindBindingsResponse,
    ListStreams,
    ListStreamsResponse,
    ReleaseStream,
    ReleaseStreamResponse,
    RenewStream,
    RenewStreamResponse,
    ReplanStream,
    ReplanStreamResponse,
)

from dyknow.errors import BadParameter, DyKnowError
from dyknow.guards import Guards
from dyknow.manager.claim import Claim
from dyknow.manager.claims.answers import StreamAnswers, refusal_of
from dyknow.manager.claims.reconciler import StreamReconciler
from dyknow.manager.specifications.tags import written_bindings
from dyknow.model.streams import StreamRequest
from dyknow.ros.manager.service_group import ServiceGroup
from dyknow.ros.messages import (
    acquire_from,
    acquisition_message,
    refusal_message,
    replanned_message,
    stream_message,
)


class StreamServices:
    """Services about streams."""

    def __init__(
        self,
        reconciler: StreamReconciler,
        guards: Guards,
        answers: StreamAnswers,
        after_change: Callable[[], None],
        remark: Callable[[], str],
        unknown_labels: Callable[[Sequence[str]], Sequence[str]],
    ) -> None:
        """Offer the services.

        Args:
            reconciler: does what they are asked for.
            guards: what is forbidden.
            answers: makes what clients are shown of claims.
            after_change: called after each attempt to change something, before it is answered.
            remark: what the answer to a change has to add; empty for nothing.
            unknown_labels: says which of the labels that a client excludes belong to nothing.
        """
        self._reconciler = reconciler
        self._guards = guards
        self._answers = answers
        self._unknown_labels = unknown_labels
        self._group = ServiceGroup(after_change, remark)
        self._attempt = self._group.attempt
        self.close = self._group.close
        self._group.offer("acquire_stream", AcquireStream, self._acquire)
        self._group.offer("release_stream", ReleaseStream, self._release)
        self._group.offer("renew_stream", RenewStream, self._renew)
        self._group.offer("replan_stream", ReplanStream, self._replan)
        self._group.offer("list_streams", ListStreams, self._list)
        self._group.offer("find_bindings", FindBindings, self._find_bindings)

    def _acquire(self, request: Any) -> AcquireStreamResponse:
        answers: List[AcquireStreamResponse] = []

        def acquire() -> None:
            wanted = self._checked(request)
            acquired = self._reconciler.acquire(wanted, request.dry_run)
            warnings = self._unknown_labels(wanted.exclude)
            answers.append(acquisition_message(self._answers.acquisition(acquired, warnings)))

        what = f"{'planning' if request.dry_run else 'acquiring'} '{request.tag}'"
        error = self._attempt(request, what, acquire)
        return answers[0] if error is None else refusal_message(refusal_of(error))

    def _release(self, request: Any) -> ReleaseStreamResponse:
        def release() -> None:
            self._guards.check_sizes([request.claim_id])
            self._guards.check_writable(f"releasing '{request.claim_id}'")
            self._reconciler.release(request.claim_id)

        error = self._attempt(request, f"releasing stream '{request.claim_id}'", release)
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

        error = self._attempt(request, f"replanning stream '{request.claim_id}'", replan)
        if error is not None:
            return ReplanStreamResponse(success=False, message=str(error))
        return answers[0]

    def _list(self, request: Any) -> ListStreamsResponse:
        return ListStreamsResponse(
            [stream_message(self._answers.status(each)) for each in self._reconciler.claims()]
        )

    def _find_bindings(self, request: Any) -> FindBindingsResponse:
        try:
            self._guards.check_sizes([request.tag, request.datatype])
            found, are_all = self._reconciler.find_bindings(request.tag, request.datatype)
        except DyKnowError as error:
            return FindBindingsResponse(False, str(error), [])
        message = "" if are_all else "there may be more: the search took too long"
        return FindBindingsResponse(True, message, [written_bindings(each) for each in found])

    def _checked(self, request: Any) -> StreamRequest:
        texts = (request.tag, request.datatype, request.client_id, request.request_id)
        names = (*request.exclude, *request.prefer, *request.avoid)
        self._guards.check_sizes((*texts, request.bond_id, *names), entries=len(names))
        return acquire_from(request)


def _lease(request: Any) -> float:
    lease = float(request.lease.to_sec())
    if lease < 0:
        raise BadParameter("lease", f"{lease:g}", "seconds from 0 (which means: until released)")
    return lease
