"""``python -m skin2urdf``."""

import sys

from skin2urdf.cli.main import main

sys.exit(main())
