"""What tests draw at random, and how often."""

from __future__ import annotations

from hypothesis import settings


def examples(count: int) -> settings:
    """Return the settings of a test: `count` examples, or as many as the profile explores."""
    exploring = settings.get_current_profile_name() == "explore"
    return settings(max_examples=max(count, settings().max_examples) if exploring else count)
