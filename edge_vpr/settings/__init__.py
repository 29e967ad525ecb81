"""Settings of mapping and matching, and the one description of each for flags, files and docs.

>>> from edge_vpr.settings import resolve_settings
>>> resolve_settings("paper", flags={"tau": "250ms"}).tau_us
250000
"""

from edge_vpr.settings.choices import STRATEGIES, Anchor, QueryMean, Strategy
from edge_vpr.settings.fields import SettingField
from edge_vpr.settings.presets import PRESETS, resolve_settings
from edge_vpr.settings.settings import SETTING_FIELDS, Settings
from edge_vpr.settings.words import duration_us

__all__ = [
    "PRESETS",
    "SETTING_FIELDS",
    "STRATEGIES",
    "Anchor",
    "QueryMean",
    "SettingField",
    "Settings",
    "Strategy",
    "duration_us",
    "resolve_settings",
]
