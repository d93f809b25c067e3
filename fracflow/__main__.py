"""python -m fracflow."""

import os
import sys

if sys.path and sys.path[0] in ("", os.path.abspath(os.curdir)):
    del sys.path[0]  # the working folder, put there by -m: what lies beside a scene is no package

from fracflow.cli.app import main

main()
