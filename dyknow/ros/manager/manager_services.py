"""The services of the DyKnow manager, over its methods."""

from __future__ import annotations

import logging
from typing import Any, Callable, Dict, List, Sequence, Tuple

import rospy
from dyknow_msgs.srv import (
    AddTransformation,
    AddTransformationResponse,
    Destroy,
    DestroyResponse,
    GetModel,
    GetModelResponse,
    RemoveTransformation,
    RemoveTransformationResponse,
    SetProtection,
    SetProtectionResponse,
    Spawn,
    SpawnResponse,
)

from dyknow.errors import DuplicatePort, DyKnowError, InvalidConfiguration
from dyknow.manager.manager import Manager
from dyknow.model.graph import SpawnRequest
from dyknow.ros.log_text import for_log
from dyknow.ros.manager.remarks import with_remark
from dyknow.ros.messages import config_pairs
from dyknow.ros.model_messages import ModelMessages
from dyknow.ros.nodelets.guard_parameters import caller_of

_log = logging.getLogger("rosout.dyknow")


class ManagerServices:
    """Offers the manager's services until it is closed."""

    def __init__(
        self, manager: Manager, messages: ModelMessages, after_change: Callable[[], None]
    ) -> None:
        """Offer them.

        Args:
            manager: does it.
            messages: makes the answers of get_model.
            after_change: called after each attempt to change something, before it is answered.
        """
        self._manager = manager
        self._messages = messages
        self._after_change = after_change
        self._services: List[Any] = [
            rospy.Service(name, service_class, with_remark(handler, lambda: manager.store.remark))
            for name, service_class, handler in (
                ("~add_transformation", AddTransformation, self._add_transformation),
                ("~remove_transformation", RemoveTransformation, self._remove_transformation),
                ("~spawn", Spawn, self._spawn),
                ("~destroy", Destroy, self._destroy),
                ("~set_protection", SetProtection, self._set_protection),
                ("~get_model", GetModel, self._get_model),
            )
        ]

    def close(self) -> None:
        """Withdraw them."""
        while self._services:
            self._services.pop().shutdown("the manager ends")

    def _add_transformation(self, request: Any) -> AddTransformationResponse:
        added: List[str] = []

        def add() -> str:
            found = self._manager.add_transformation(request.specification)
            added.extend(sorted({each.label for each in found.transformations}))
            return "\n".join(str(warning) for warning in found.warnings)

        success, message = self._try(request, "adding transformations", add)
        return AddTransformationResponse(success, message, added)

    def _remove_transformation(self, request: Any) -> RemoveTransformationResponse:
        def remove() -> None:
            self._check_sizes(request.label)
            self._manager.remove_transformation(request.label)

        what = f"removing transformation '{request.label}'"
        return RemoveTransformationResponse(*self._try(request, what, remove))

    def _spawn(self, request: Any) -> SpawnResponse:
        def spawn() -> None:
            pairs = config_pairs(request.config)
            texts = [text for pair in pairs for text in pair]
            self._check_sizes(
                request.label, request.name, request.manager, *texts, entries=len(pairs)
            )
            manager = self._manager.resolve(request.manager) if request.manager else ""
            self._manager.spawn(
                SpawnRequest(
                    request.label,
                    request.name,
                    _mapping(request.name, pairs),
                    request.is_protected,
                    request.isolated,
                    manager,
                )
            )

        what = f"spawning '{request.name}' from '{request.label}'"
        return SpawnResponse(*self._try(request, what, spawn))

    def _destroy(self, request: Any) -> DestroyResponse:
        def destroy() -> None:
            self._check_sizes(request.name)
            self._manager.destroy(request.name)

        return DestroyResponse(*self._try(request, f"destroying '{request.name}'", destroy))

    def _set_protection(self, request: Any) -> SetProtectionResponse:
        def protect() -> None:
            self._check_sizes(request.name)
            self._manager.set_protection(request.name, request.is_protected)

        what = f"{'protecting' if request.is_protected else 'releasing'} '{request.name}'"
        return SetProtectionResponse(*self._try(request, what, protect))

    def _get_model(self, request: Any) -> GetModelResponse:
        return self._messages.response(self._manager.get_model())

    def _check_sizes(self, *texts: str, entries: int = 0) -> None:
        self._manager.guards.check_sizes(texts, entries)

    def _try(self, request: Any, what: str, action: Callable[[], str | None]) -> Tuple[bool, str]:
        """Do what a request asks for; the answer says whether it worked, and why not."""
        what, caller = for_log(what), for_log(caller_of(request))
        try:
            message = self._followed_up(action) or ""
        except DyKnowError as error:
            rospy.logwarn("%s for %s: refused: %s", what, caller, for_log(error))
            return False, str(error)
        except Exception as error:  # the boundary of the service
            _log.exception("%s for %s failed", what, caller)
            return False, f"internal error: {type(error).__name__}: {error}"
        rospy.loginfo("%s for %s: done", what, caller)
        return True, message

    def _followed_up(self, action: Callable[[], str | None]) -> str | None:
        try:
            return action()
        finally:
            self._after_change()


def _mapping(name: str, pairs: Sequence[Tuple[str, str]]) -> Dict[str, str]:
    mapping = dict(pairs)
    if len(mapping) < len(pairs):
        ports = [port for port, _ in pairs]
        doubled = sorted({port for port in ports if ports.count(port) > 1})
        raise InvalidConfiguration(name, [DuplicatePort(port) for port in doubled])
    return mapping
