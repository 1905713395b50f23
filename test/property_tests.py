# SPDX-FileCopyrightText: 2026 the DyKnow developers
# SPDX-License-Identifier: BSD-3-Clause

"""How many examples the property tests try, and for how long.

``HYPOTHESIS_PROFILE=slow`` is for machines that are slow or busy: a tenth of the examples.
"""

from __future__ import annotations

import os
from typing import Any

from hypothesis import HealthCheck, settings

PROFILE = os.environ.get("HYPOTHESIS_PROFILE", "usual")
FEWER = {"usual": 1, "slow": 10}


def register_profiles() -> None:
    """Make the profile of the environment the one of this process."""
    # No deadline: an example that had to wait for its processor has not failed.
    settings.register_profile("usual", deadline=None)
    settings.register_profile(
        "slow", deadline=None, max_examples=10, suppress_health_check=[HealthCheck.too_slow]
    )
    settings.load_profile(PROFILE)


def examples(count: int, **options: Any) -> settings:
    """Settings for a test that tries `count` examples, or fewer of them in a slower profile."""
    return settings(max_examples=max(1, count // FEWER[PROFILE]), deadline=None, **options)
