# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How many examples the property tests try, and for how long.

The usual examples are the same in each run: they keep a known fault from coming back, and are few.
``HYPOTHESIS_PROFILE=random``, which ``make test-long`` uses, finds new faults with thirty times as
many; ``HYPOTHESIS_PROFILE=slow`` is for machines that are slow or busy.
"""

from __future__ import annotations

import os
from typing import Any

from hypothesis import HealthCheck, settings

PROFILE = os.environ.get("HYPOTHESIS_PROFILE", "usual")
#: Examples of each profile, to those of the usual one.
SHARES = {"usual": 0.15, "slow": 0.1, "random": 5.0}


def register_profiles() -> None:
    """Make the profile of the environment the one of this process."""
    # Neither a deadline nor a check of speed: a test that waits for its processor has not failed.
    for name, share in SHARES.items():
        settings.register_profile(
            name,
            deadline=None,
            derandomize=name != "random",
            max_examples=int(100 * share),
            suppress_health_check=[HealthCheck.too_slow],
        )
    settings.load_profile(PROFILE)


def examples(count: int, **options: Any) -> settings:
    """Settings for a test that tries `count` examples, or its profile's share of them."""
    return settings(max_examples=max(1, int(count * SHARES[PROFILE])), deadline=None, **options)
