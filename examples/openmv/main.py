"""Send the events of a GENX320 on an OpenMV camera as `evpr` frames (docs/protocol_evpr.md).

Save this file on the camera as main.py, connect the transmit pin of its UART to the host, and run:

    edge-vpr stream --port /dev/ttyUSB0 --baud 921600 --protocol evpr --map map.npz --precision 0.99

The script drops and counts events that the line cannot carry. The sensor drops others uncounted.
"""

import os
import struct
import time
from array import array
from binascii import crc32

import csi
import micropython
from machine import UART
from ulab import numpy as np

PORT, BAUD = 1, 921_600
#: events per read, a power of two from 1,024 on, and events per frame
READ, MOST = 1024, 512
#: bytes of an event on the line, with its share of what a frame adds
EVENT_BYTES = 5
#: silence after which a frame without events shows that time has passed
SILENT_US = 100_000
HEADER, HEADER_BYTES = "<BBHIIQ", 20


@micropython.viper
def pack(events: ptr16, state: ptr32, out: ptr8) -> int:  # noqa: F821
    """Write events as words of 4 bytes behind the header, and return where they end.

    A row of `events` has the type, seconds, milliseconds, microseconds, x and y. `state` holds the
    first row, the row after the last one, the second from which times count, the time of the last
    word in microseconds, and the number of events. `pack` updates the last two.
    """
    at = 20
    time_us = state[3]
    for row in range(state[0], state[1]):
        i = 6 * row
        if events[i] > 1:
            continue  # a trigger
        second = (events[i + 1] - state[2]) & 0xFFFF
        now_us = (second * 1000 + events[i + 2]) * 1000 + events[i + 3]
        step = now_us - time_us
        if step < 0:
            step = 0
        time_us += step
        while step > 8190:  # a pause has ones in the bits of the time
            pause = step
            if pause > 524_287:
                pause = 524_287
            out[at] = pause & 255
            out[at + 1] = (pause >> 8) & 255
            out[at + 2] = 0xF8 | (pause >> 16)
            out[at + 3] = 255
            at += 4
            step -= pause
        x = events[i + 4]
        y = events[i + 5]
        out[at] = x & 255
        out[at + 1] = (x >> 8) | ((y & 127) << 1)
        out[at + 2] = (y >> 7) | (events[i] << 2) | ((step & 31) << 3)
        out[at + 3] = step >> 5
        at += 4
        state[4] += 1
    state[3] = time_us
    return at


@micropython.viper
def stuff(data: ptr8, size: int, out: ptr8) -> int:  # noqa: F821
    """Stuff bytes by COBS, end them with a zero, and return the length."""
    code_at = 0
    at = 1
    for i in range(size):
        if data[i] != 0:
            out[at] = data[i]
            at += 1
        if data[i] == 0 or at - code_at == 255:
            out[code_at] = at - code_at
            code_at = at
            at += 1
    out[code_at] = at - code_at
    out[at] = 0
    return at + 1


class Sender:
    """Frames events, and writes the frames to a line."""

    def __init__(self, line):
        self.line, self.boot = line, struct.unpack("<H", os.urandom(2))[0]
        self.sent = self.dropped = 0
        self.frame, self.stuffed = bytearray(8192), bytearray(8300)

    def send(self, base_us, end, events):
        """Send the words in `frame` up to `end`, which hold this number of events."""
        counts = self.sent & 0xFFFFFFFF, self.dropped & 0xFFFFFFFF
        struct.pack_into(HEADER, self.frame, 0, 0x14, 0x99, self.boot, *counts, base_us)
        struct.pack_into("<I", self.frame, end, crc32(memoryview(self.frame)[:end]))
        size = stuff(self.frame, end + 4, self.stuffed)
        self.line.write(memoryview(self.stuffed)[:size])
        self.sent += events


def main():
    """Read events and send them until the camera is switched off."""
    camera, sender = csi.CSI(cid=csi.GENX320), Sender(UART(PORT, BAUD))
    camera.reset()
    camera.ioctl(csi.IOCTL_GENX320_SET_MODE, csi.GENX320_MODE_EVENT, READ)
    events = np.zeros((READ, 6), dtype=np.uint16)
    second, last_us = -1, 0  # of the newest event; the sensor counts 16 bits of seconds
    room, then, heard = 0.0, time.ticks_us(), time.ticks_us()
    sender.send(0, HEADER_BYTES, 0)
    while True:
        number = max(camera.ioctl(csi.IOCTL_GENX320_READ_EVENTS, events), 0)
        now = time.ticks_us()
        room = min(room + time.ticks_diff(now, then) * BAUD / 1e7, EVENT_BYTES * READ)
        then = now
        if number == 0:
            silent_us = time.ticks_diff(now, heard)
            if silent_us > SILENT_US:
                heard, last_us = now, last_us + silent_us
                sender.send(last_us, HEADER_BYTES, 0)
            continue
        heard = now
        carried = min(number, int(room) // EVENT_BYTES)
        room -= EVENT_BYTES * carried
        shown = int(events[0, 1])
        ahead = 0 if second < 0 else (shown - second + 32_768 & 0xFFFF) - 32_768
        second = shown if second < 0 else second + ahead
        origin_us = second * 1_000_000
        for first in range(0, carried, MOST):
            base_us = max(last_us, origin_us)
            last = min(first + MOST, carried)
            state = array("I", [first, last, second & 0xFFFF, base_us - origin_us, 0])
            end = pack(events, state, sender.frame)
            sender.send(base_us, end, state[4])
            last_us = origin_us + state[3]
        sender.dropped += number - carried


if __name__ == "__main__":
    main()
