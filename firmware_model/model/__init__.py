"""What a device computes, bit for bit: descriptor, comparator, memories."""
