"""Power and energy of the machine: sensors, sampling, and statistics."""
