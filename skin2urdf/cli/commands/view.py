"""``skin2urdf view``: a robot in the browser."""

from __future__ import annotations

import argparse

from skin2urdf.cli.arguments import Parser, add_number
from skin2urdf.cli.terminal import progress_bar
from skin2urdf.errors import UsageError

HELP = "show robots in the browser, joint by joint"
EPILOG = """\
example:
  skin2urdf view robot.urdf
  skin2urdf view robot.urdf truth.urdf --log log.mcap

Opens a port on this machine alone (127.0.0.1) and prints its address. Every joint has a slider, a
click on an SU tells where it sits and how well that is known, --log plays a recording. A second
URDF is laid over the first, each limb where it fits best. Ctrl-C ends it.
Needs viser: pip install 'skin2urdf[view]'"""


def declare(command: Parser) -> None:
    """Add what the command takes."""
    command.add_argument("urdf", metavar="URDF", help="what `skin2urdf calibrate` wrote, or any")
    command.add_argument(
        "other", metavar="OTHER", nargs="?", help="another one: the truth, a vendor's model"
    )
    command.add_argument("--log", metavar="LOG", help="recording to play")
    add_number(
        command.add_argument_group("server"), "--port", 8080, "port to open (%(default)s)", int
    )


def run(options: argparse.Namespace) -> int:
    """Do it; the exit status."""
    if not 0 < options.port < 65536:
        raise UsageError(f"--port {options.port} is no port", "give 1024 to 65535")
    from skin2urdf.view.actors import load_play
    from skin2urdf.view.recorded import load_motion
    from skin2urdf.view.viewer import Viewer, check_library

    check_library()
    with progress_bar(options.quiet) as bar:
        bar("loading", 0.0)
        play = load_play(options.urdf, options.other)
        motion = None
        if options.log:
            motion = load_motion(options.log, lambda share: bar("reading", share))
    viewer = Viewer(play, motion, options.port)
    try:
        print(f"open {viewer.address} in a browser; Ctrl-C ends it", flush=True)
        viewer.run()
    except KeyboardInterrupt:
        pass
    finally:
        viewer.stop()
    return 0
