"""Makes the pictures of docs/pictures.md beside this file."""

from pathlib import Path

import statechart

HERE = Path(__file__).parent

if __name__ == "__main__":
    stick = statechart.run("toppling_stick")
    stick.animate(HERE / "toppling_stick.gif", size=480)
    stick.plot(HERE / "toppling_stick_plot.png")
