"""`python -m tnst_mi`: the command `tnst-mi`, for when its script is not on the PATH."""

import sys

from tnst_mi.cli import main

sys.exit(main())
