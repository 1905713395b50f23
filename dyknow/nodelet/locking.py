"""The one lock that every message passes under.

Strands, connections and publications guard their state with the same lock instead of one each. A
message mostly comes after a pause, when little of what it touches is in the processor's caches:
with locks of their own, a hop spent a third of its time on fetching these. Nothing is contended
that would not be anyway, since one thread at a time runs Python; what is done under the lock takes
about a microsecond, and nothing of a nodelet is called there. It is reentrant since a signal
handler or a finalizer that publishes may come in between.
"""

from __future__ import annotations

import threading

message_lock = threading.RLock()
