"""``python3 -m dyknow_demo``."""

import sys

from dyknow_demo.main import main

sys.exit(main())
