"""Matches of `edge-vpr stream --serve` as messages of ROS 2."""
