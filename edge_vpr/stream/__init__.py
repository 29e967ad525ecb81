"""Live from a serial-attached camera: links, protocols, health, and a localiser that keeps up."""
