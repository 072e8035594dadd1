"""What `help` shows of a class that users see."""

from __future__ import annotations


class Shown(type):
    """The class of classes of which `help` shows what they declare, not what every class has."""

    def __dir__(cls) -> list[str]:
        ours = (vars(base) for base in cls.__mro__ if base.__module__ != "builtins")
        return sorted({name for names in ours for name in names if not name.startswith("_")})
