"""What the answer to a change has to add: that it is done, but not on disk yet."""

from __future__ import annotations

from typing import Any, Callable

Handler = Callable[[Any], Any]


def with_remark(handler: Handler, remark: Callable[[], str]) -> Handler:
    """Let a service's answers end with a remark, if there is one and something was done."""

    def answer(request: Any) -> Any:
        response = handler(request)
        if getattr(response, "success", False) and not getattr(request, "dry_run", False):
            response.message = "\n".join(filter(None, (response.message, remark())))
        return response

    return answer
