"""From events to descriptors: cleaning, pixel selection, windows, counters and counter codes."""
