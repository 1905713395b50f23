"""``python3 -m dyknow_benchmark``."""

import sys

from dyknow_benchmark.main import main

sys.exit(main())
