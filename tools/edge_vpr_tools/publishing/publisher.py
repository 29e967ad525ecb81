"""Interface of publishers, which send the rows of a live run to other programs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Protocol

from edge_vpr_tools.publishing.line_server import LineServer
from edge_vpr_tools.publishing.mqtt import open_mqtt


class Publisher(Protocol):
    """Sends rows to readers, without ever waiting for a reader.

    Attributes
    ----------
    name : str
        Kind of the row that its notices are.
    """

    name: str

    def send(self, kind: str, line: str) -> None:
        """Send a row of JSON.

        Parameters
        ----------
        kind : str
            The row's own.
        line : str
            Without a line feed.
        """

    def notices(self) -> Iterator[tuple[str, bool]]:
        """Yield what happened since the last call, and whether it is good news."""


@contextmanager
def open_publishers(serve: str | None, mqtt: str | None) -> Iterator[tuple[Publisher, ...]]:
    """Open the requested publishers, until the block ends.

    Parameters
    ----------
    serve : str or None
        ``[HOST:]PORT`` to listen on.
    mqtt : str or None
        ``mqtt://[USER@]HOST[:PORT]/TOPIC``.

    Raises
    ------
    UsageError
        If an address is none, or a library is missing.
    LinkError
        If the port cannot be listened on.
    """
    with ExitStack() as stack:
        publishers: list[Publisher] = []
        if serve is not None:
            publishers.append(stack.enter_context(LineServer(serve)))
        if mqtt is not None:
            publishers.append(stack.enter_context(open_mqtt(mqtt)))
        yield tuple(publishers)
