# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""Where the user has put vertices: kept for each wiring."""

from __future__ import annotations

import json
import zlib
from typing import Dict, Iterable, Mapping

from dyknow_rqt.graph.geometry import Point

#: The most wirings whose places are kept.
_MOST = 20


class Places:
    """The places of the present wiring, which is known by the names of its nodelets.

    A wiring that was not seen before takes over the places of the one before it.

    Attributes:
        present: centres by the keys of vertices.
    """

    def __init__(self) -> None:
        self.present: Dict[str, Point] = {}
        self._wiring = ""
        self._kept: Dict[str, Dict[str, Point]] = {}

    def follow(self, nodelets: Iterable[str]) -> None:
        """Turn to the wiring of these nodelets."""
        wiring = f"{zlib.crc32(' '.join(sorted(nodelets)).encode()):08x}"
        if wiring != self._wiring:
            self._wiring = wiring
            self.present = dict(self._kept.get(wiring, self.present))

    def put(self, places: Mapping[str, Point]) -> None:
        self.present.update(places)
        self._keep()

    def forget(self) -> None:
        """Forget all places of the present wiring."""
        self.present.clear()
        self._keep()

    def to_text(self) -> str:
        self._keep()  # also what was taken over
        return json.dumps(self._kept) if self._kept else ""

    def read(self, text: str) -> None:
        """Read what ``to_text`` wrote; a text that is not that is ignored."""
        try:
            self._kept = {
                str(wiring): {str(key): Point(float(x), float(y)) for key, (x, y) in each.items()}
                for wiring, each in json.loads(text or "{}").items()
            }
        except (AttributeError, TypeError, ValueError):
            return
        self.present = dict(self._kept.get(self._wiring, {}))

    def _keep(self) -> None:
        self._kept.pop(self._wiring, None)
        if self.present:
            self._kept[self._wiring] = dict(self.present)
        for wiring in list(self._kept)[:-_MOST]:
            del self._kept[wiring]
