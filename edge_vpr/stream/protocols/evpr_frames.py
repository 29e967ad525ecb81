"""Layout of this project's own frames; see docs/protocol_evpr.md."""

from __future__ import annotations

import struct

#: Longest frame before stuffing, and after stuffing (without the zero at its end).
MAX_FRAME = 8_192
MAX_STUFFED = MAX_FRAME + MAX_FRAME // 254 + 1
#: kind, widths, boot, sequence, dropped, base time
HEADER = struct.Struct("<BBHIIQ")
CHECK = struct.Struct("<I")
VERSION = 1
#: ends each frame; on its own, it is an empty frame
FRAME_END = b"\0"
