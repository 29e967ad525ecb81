"""Run the node without installing it: python3 edge_vpr_node.py --connect 127.0.0.1:7000."""

import sys

from edge_vpr_ros.node import main

if __name__ == "__main__":
    sys.exit(main())
