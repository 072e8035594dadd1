"""What `help` shows of a class: what users call and read."""

from __future__ import annotations


class Shown(type):
    """The class of public classes, whose `help` is their documentation.

    What every class and every exception of Python has is left out, and so are the fields of a
    dataclass, which its docstring tells. Instances have all of it.
    """

    def __dir__(cls) -> list[str]:
        fields: dict[str, object] = getattr(cls, "__dataclass_fields__", {})
        return [
            name
            for name in super().__dir__()
            if not name.startswith("_") and name not in fields and not _of_python(cls, name)
        ]


def _of_python(cls: type, name: str) -> bool:
    """Whether a name is first defined in a class of Python itself."""
    homes = [home for home in cls.__mro__ if name in home.__dict__]
    return bool(homes) and homes[0].__module__ == "builtins"
