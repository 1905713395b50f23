"""Names of the nodelets that are made for claims."""

from __future__ import annotations

import re
from typing import Iterator

#: Names that are tried for one transformation.
_MOST = 10_000


def free_names(label: str) -> Iterator[str]:
    """Name nodelets of a transformation: ``bottom camera`` gives bottom_camera_1, _2 and so on."""
    stem = re.sub(r"[^A-Za-z0-9_]+", "_", label).strip("_")
    if not stem[:1].isalpha():
        stem = f"nodelet_{stem}".rstrip("_")
    for number in range(1, _MOST):
        yield f"{stem}_{number}"
