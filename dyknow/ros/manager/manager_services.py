# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""The services of the DyKnow manager, over its methods."""

from __future__ import annotations

from typing import Any, Callable, Dict, Optional, Sequence, Tuple

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

from dyknow.errors import DuplicatePort, InvalidConfiguration
from dyknow.manager.manager import Manager
from dyknow.manager.specifications.given import undeclared
from dyknow.model.graph import SpawnRequest
from dyknow.ros.installed import missing_here
from dyknow.ros.manager.service_group import ServiceGroup
from dyknow.ros.messages import config_pairs, parameters_from
from dyknow.ros.model_messages import ModelMessages


class ManagerServices:
    """Services about transformations and nodelets."""

    def __init__(
        self, manager: Manager, messages: ModelMessages, after_change: Callable[[], None]
    ) -> None:
        """Offer the services.

        Args:
            manager: does what they are asked for.
            messages: makes the answers of get_model.
            after_change: called after each attempt to change something, before it is answered.
        """
        self._manager = manager
        self._messages = messages
        self._group = ServiceGroup(after_change, lambda: manager.store.remark)
        self._attempt = self._group.attempt
        self.close = self._group.close
        self._group.offer("add_transformation", AddTransformation, self._add_transformation)
        self._group.offer("remove_transformation", RemoveTransformation, self._remove)
        self._group.offer("spawn", Spawn, self._spawn)
        self._group.offer("destroy", Destroy, self._destroy)
        self._group.offer("set_protection", SetProtection, self._set_protection)
        self._group.offer("get_model", GetModel, self._get_model)

    def _add_transformation(self, request: Any) -> AddTransformationResponse:
        answer = AddTransformationResponse()

        def add() -> None:
            found = self._manager.add_transformation(request.specification)
            answer.labels = sorted({each.label for each in found.transformations})
            missing = missing_here("specification", found.transformations)
            answer.message = "\n".join(map(str, (*found.warnings, *missing)))

        error = self._attempt(request, "adding transformations", add)
        answer.success = error is None
        if error is not None:
            answer.message = str(error)
        return answer

    def _remove(self, request: Any) -> RemoveTransformationResponse:
        def remove() -> None:
            self._check_sizes(request.label)
            self._manager.remove_transformation(request.label)

        what = f"removing transformation '{request.label}'"
        return RemoveTransformationResponse(*_answer(self._attempt(request, what, remove)))

    def _spawn(self, request: Any) -> SpawnResponse:
        answer = SpawnResponse()

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
            answer.message = "\n".join(undeclared(made.transformation, given))

        what = f"spawning '{request.name}' from '{request.label}'"
        error = self._attempt(request, what, spawn)
        answer.success = error is None
        if error is not None:
            answer.message = str(error)
        return answer

    def _destroy(self, request: Any) -> DestroyResponse:
        def destroy() -> None:
            self._check_sizes(request.name)
            self._manager.destroy(request.name)

        what = f"destroying '{request.name}'"
        return DestroyResponse(*_answer(self._attempt(request, what, destroy)))

    def _set_protection(self, request: Any) -> SetProtectionResponse:
        def protect() -> None:
            self._check_sizes(request.name)
            self._manager.set_protection(request.name, request.is_protected)

        what = f"{'protecting' if request.is_protected else 'releasing'} '{request.name}'"
        return SetProtectionResponse(*_answer(self._attempt(request, what, protect)))

    def _get_model(self, request: Any) -> GetModelResponse:
        return self._messages.response(self._manager.get_model())

    def _check_sizes(self, *texts: str, entries: int = 0) -> None:
        self._manager.guards.check_sizes(texts, entries)


def _answer(error: Optional[Exception]) -> Tuple[bool, str]:
    return error is None, str(error or "")


def _mapping(name: str, pairs: Sequence[Tuple[str, str]]) -> Dict[str, str]:
    mapping = dict(pairs)
    if len(mapping) < len(pairs):
        ports = [port for port, _ in pairs]
        doubled = sorted({port for port in ports if ports.count(port) > 1})
        raise InvalidConfiguration(name, [DuplicatePort(port) for port in doubled])
    return mapping
