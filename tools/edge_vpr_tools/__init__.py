"""The installed commands of edge-vpr."""
