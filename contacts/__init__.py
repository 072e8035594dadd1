"""Rigid bodies in contact, as statecharts: free, slide, pin.

A `Scene` declares bodies, surfaces and contacts with their modes; `statechart.run` and the other
functions of `statechart` take it as they take any model. All other names are internal.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from contacts.scene.controls import Controller, ControlRegion, ControlState
    from contacts.scene.couplings import Coupling
    from contacts.scene.friction import StaticKinetic
    from contacts.scene.joints import Force, Joint, Path
    from contacts.scene.modes import Free, Pin, Slide
    from contacts.scene.parts import Body, Contact, Coordinate, Point, Surface
    from contacts.scene.scene import Scene
    from contacts.scene.shapes import Collision, Shape

__all__ = [
    "Body",
    "Collision",
    "Contact",
    "ControlRegion",
    "ControlState",
    "Controller",
    "Coordinate",
    "Coupling",
    "Force",
    "Free",
    "Joint",
    "Path",
    "Pin",
    "Point",
    "Scene",
    "Shape",
    "Slide",
    "StaticKinetic",
    "Surface",
]

_HOMES = {
    "scene.controls": ("ControlRegion", "ControlState", "Controller"),
    "scene.couplings": ("Coupling",),
    "scene.friction": ("StaticKinetic",),
    "scene.joints": ("Force", "Joint", "Path"),
    "scene.modes": ("Free", "Pin", "Slide"),
    "scene.scene": ("Scene",),
    "scene.shapes": ("Collision", "Shape"),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME.get(name, 'scene.parts')}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
