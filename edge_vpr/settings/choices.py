"""Types of the settings that are chosen from a few words."""

from __future__ import annotations

from typing import Literal, get_args

Strategy = Literal["variance", "seed-code", "random", "random-upper", "top", "information"]
STRATEGIES: tuple[str, ...] = get_args(Strategy)
WindowKind = Literal["time", "count"]
CounterCodeName = Literal["none", "linear", "sqrt", "log"]
CounterScaling = Literal["shared", "per-pixel", "own-mean"]
QueryMean = Literal["own", "running"]
Matching = Literal["sequence", "filter"]
Anchor = Literal["middle", "end"]
Score = Literal["distance", "ratio", "margin", "trust"]
