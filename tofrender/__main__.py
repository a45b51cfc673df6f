"""`python -m tofrender` is the `tofrender` command."""

import sys

from tofrender.cli.app import main

sys.exit(main())
