"""The ready parameters, by name; `configs/` has them with what a run of the product needs."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

READY: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "paper": {},
        "auto": {"removal": {"decision": "auto", "confidence": 0.5}},
        "indoor": {"max_height": 2.5},
        "outdoor": {
            "ground": {
                "method": "slope",
                "slope": {
                    "cell": 1.5,
                    "clearance": None,
                    "flatness": 0.3,
                    "continuity": 2.0,
                    "window": 18.0,
                    "slope": 0.2,
                    "step": 0.0,
                    "extension": 10.0,
                    "steepest": 100.0,
                    "tolerance": 0.25,
                    "noise_tolerance": 0.75,
                    "slope_tolerance": 1.25,
                    "tolerance_limit": 100.0,
                },
            }
        },
    }
)
"""Sections that differ from the defaults."""
