"""``python -m skin2urdf``."""

import sys

from skin2urdf.cli import main

sys.exit(main())
