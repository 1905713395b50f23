"""``python3 -m dyknow.demo``."""

import sys

from dyknow.demo.main import main

sys.exit(main())
