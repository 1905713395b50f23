"""``python3 -m dyknow.benchmark``."""

import sys

from dyknow.benchmark.main import main

sys.exit(main())
