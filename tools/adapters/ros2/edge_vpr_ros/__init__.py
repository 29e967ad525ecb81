"""Matches of `edge-vpr stream --http` as messages of ROS 2."""
