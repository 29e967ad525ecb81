"""From events to matches in one compiled call: removal of bursts, then the localiser."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from edge_vpr.boxed import Boxed
from edge_vpr.compiling import entry, kernel
from edge_vpr.descriptors.causal_bursts import CausalBurstFilter, keep
from edge_vpr.events import Events
from edge_vpr.online.followed import FEW, Followed
from edge_vpr.online.kernel import DONE, REFUSED, Few, follow_few
from edge_vpr.online.localiser import Localiser
from edge_vpr.online.match_run import Found

#: A step of the clock is a jump if it is longer than this time and than this number of ticks.
JUMP_US = 1_000_000
MOST_TICKS = 10_000

Kernel = Callable[..., Any]
Step = tuple[int, Found, int, tuple[Events, ...]]
"""How far a stream has been matched: the time up to which it is known, the matches, the time of the
last event matched (-1 if none was), and events in no burst that have yet to be matched."""


class Follower:
    """Feeds events to a burst filter and a localiser in one compiled call.

    Parameters
    ----------
    bursts : CausalBurstFilter
    localiser : Localiser
    """

    def __init__(self, bursts: CausalBurstFilter, localiser: Localiser) -> None:
        bursts.make_room(FEW)
        self._bursts, self._run = bursts, localiser.run
        # the last kernel, all state that it was bound to, and its code with this state
        self._bound: tuple[Kernel | None, tuple[Boxed, ...], Kernel] = None, (), follow_kept

    def bound(self, kernel: Kernel, sample: object, *decoder: Boxed) -> Kernel:
        """Return a kernel of one argument: `follow_kept`, or one that decodes and calls it.

        Parameters
        ----------
        kernel : callable
            Its arguments are the boxes for `follow_kept`, those of the decoder, and one more.
        sample : object
            Of the type of this one.
        decoder : Boxed
            State of the decoder.
        """
        parts = self._bursts.box.boxed, self._run.boxed, *decoder
        known, its_parts, code = self._bound
        if kernel is not known or parts != its_parts:
            code = partial(entry(kernel, *parts, sample), *parts)
            self._bound = kernel, parts, code
        return code

    def follow(self, events: Events, reached_us: int) -> Step:
        """Match the next events, with which the stream has reached `reached_us`."""
        if not 0 < events.size <= FEW:
            return reached_us, [], -1, (self._bursts.update(events),)
        if not events.flags.carray:
            events = events.copy()
        return self.go_on(events, reached_us, *self.bound(follow_kept, events)(events))

    def go_on(self, events: Events, reached_us: int, kept: int, few: Few) -> Step:
        """Do what remains to do after `follow_kept` with `events`."""
        if few[2] == REFUSED:
            return reached_us, [], -1, (self._bursts.kept(events, kept),)
        return reached_us, self._run.go_on(few), int(few[4]), ()


@kernel
def follow_kept(bursts, followed, events):  # type: ignore[no-untyped-def]
    """Remove bursts, and process the other events unless their times jump.

    Parameters
    ----------
    bursts, followed : Boxed
        Of a `CausalBurstFilter` and of a `Localiser`.
    events : ndarray of EVENT_DTYPE, shape (n,)
        0 to `FEW`.

    Returns
    -------
    kept : int
        Events that are in no burst.
    few : tuple
        See `follow_few`.
    """
    n = keep(bursts, events)
    kept = bursts.value[-1][:n]
    if n == 0:
        return n, (0, 0, DONE, 0, np.int64(-1))
    c, last = Followed(*followed.value).control[0], kept[n - 1]["t"]
    if c.interval > 0 and last - c.floor > MOST_TICKS * c.interval:
        return n, (0, 0, REFUSED, 0, last)
    return n, follow_few(followed, kept)
