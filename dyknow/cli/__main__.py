"""`python3 -m dyknow.cli` is `dyknow`."""

import sys

from dyknow.cli.main import main

sys.exit(main())
