"""`python -m bunraku` is the `bunraku` command."""

import sys

from bunraku.cli import main

sys.exit(main())
