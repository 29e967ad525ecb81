"""From descriptors to matches: distances, sequences, and the best place of each query window."""
