"""Power and energy of the machine: sensors, sampling, and what can be said from the samples."""
