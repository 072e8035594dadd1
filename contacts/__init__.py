"""Rigid bodies in contact, as statecharts: free, slide, pin.

A `Scene` declares bodies, surfaces and contacts with their modes; `statechart.run` and the other
functions of `statechart` take it as they take any model. All other names are internal.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from contacts.scene.controls import Controller as Controller
    from contacts.scene.controls import ControlRegion as ControlRegion
    from contacts.scene.controls import ControlState as ControlState
    from contacts.scene.couplings import Coupling as Coupling
    from contacts.scene.friction import StaticKinetic as StaticKinetic
    from contacts.scene.joints import Force as Force
    from contacts.scene.joints import Joint as Joint
    from contacts.scene.joints import Path as Path
    from contacts.scene.modes import Free as Free
    from contacts.scene.modes import Pin as Pin
    from contacts.scene.modes import Slide as Slide
    from contacts.scene.parts import Body as Body
    from contacts.scene.parts import Contact as Contact
    from contacts.scene.parts import Coordinate as Coordinate
    from contacts.scene.parts import Point as Point
    from contacts.scene.parts import Surface as Surface
    from contacts.scene.scene import Scene as Scene
    from contacts.scene.shapes import Collision as Collision
    from contacts.scene.shapes import Shape as Shape

_HOMES = {
    "scene.controls": "ControlRegion ControlState Controller",
    "scene.couplings": "Coupling",
    "scene.friction": "StaticKinetic",
    "scene.joints": "Force Joint Path",
    "scene.modes": "Free Pin Slide",
    "scene.parts": "Body Contact Coordinate Point Surface",
    "scene.scene": "Scene",
    "scene.shapes": "Collision Shape",
}
_HOME = {name: home for home, names in _HOMES.items() for name in names.split()}
if not TYPE_CHECKING:
    # Type checkers take the names from the imports above.
    __all__ = list(_HOME)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
