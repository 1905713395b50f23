"""Where real camera frames may lie."""

from __future__ import annotations

from pathlib import Path

#: Beside the checkout.
SHARED_FRAMES = Path(__file__).resolve().parents[2] / "shared" / "data" / "robocup_msl"
