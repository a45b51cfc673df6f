"""`python -m tofrender` is the `tofrender` command."""

import sys

from tofrender.cli import main

sys.exit(main())
