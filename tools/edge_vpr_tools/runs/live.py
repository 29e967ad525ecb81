"""A live session with everything that shows it: view, log, publishers, the Rerun viewer."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass

from edge_vpr.errors import RecordingError
from edge_vpr.live.session import LiveSession, nothing_valid
from edge_vpr.pipeline import Removed
from edge_vpr_tools.console import error_line, stopped_by_signals
from edge_vpr_tools.live_view import open_rerun, open_view
from edge_vpr_tools.progress import status, warn_if_much
from edge_vpr_tools.publish import open_publishers


@dataclass(frozen=True, kw_only=True)
class LiveOutput:
    """Where a live session is shown.

    Attributes
    ----------
    as_json : bool
        JSON lines on standard output.
    log : str or None
        File of the same lines.
    rerun, serve, mqtt : str or None
        See `open_rerun` and `open_publishers`.
    line_s : float or None
        Interval of status lines; see `View`.
    """

    as_json: bool = False
    log: str | None = None
    rerun: str | None = None
    serve: str | None = None
    mqtt: str | None = None
    line_s: float | None = None


def show_session(session: LiveSession, output: LiveOutput) -> None:
    """Open a session, show it to its end, and close everything in any case, the session last.

    Raises
    ------
    EdgeVprError
        If the link cannot be opened or fails, bytes came and none were valid, a file cannot be
        written, or a drive makes no map.
    """
    session.on_message = lambda message: None  # the command itself says that it compiles
    try:
        _show(session, output)
    finally:
        session.on_message = lambda message: error_line(message.text)
        session.close()


def _show(session: LiveSession, output: LiveOutput) -> None:
    reference = session.reference
    with ExitStack() as stack:
        rerun = stack.enter_context(open_rerun(output.rerun, session.sensor))
        stack.enter_context(stopped_by_signals(session.stopping))
        publishers = stack.enter_context(open_publishers(output.serve, output.mqtt))
        with status("kernels") as shown:
            session.warm_up(shown)
        session.open()
        # opened last, so that a missing camera does not overwrite the run before
        view = stack.enter_context(
            open_view(output.as_json, output.log, reference, publishers, output.line_s)
        )
        session.on_message = view.message
        try:
            for step in session.steps():
                for reading in step.odometry:
                    view.odometry(*reading)
                if step.result is not None:
                    view.matches(step.result, step.at_s, step.host_us)
                    if rerun is not None:
                        rerun.show(step.result)
                view.tick(session.status)
                if view.unread:
                    session.stop()
        finally:
            view.summary(session.status, session.bursts_removed)
            if reference is not None:
                removed = Removed(session.health.events, session.bursts_removed)
                warn_if_much(removed, session.address, "make the map with --bursts keep")
        if text := session.unwritten or view.unwritten:
            raise RecordingError(text)
        if text := nothing_valid(session.health):
            raise RecordingError(f"{session.address}: {text}")
