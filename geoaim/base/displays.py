"""How maps, tracks and results show themselves: a line of facts, a plot, and both in Jupyter."""

import base64
import io
from abc import ABC, abstractmethod
from html import escape
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from matplotlib.axes import Axes

THUMBNAIL_INCHES, THUMBNAIL_DPI = (5.6, 3.6), 80


class Display(ABC):
    """Base class of data: its repr is a line of facts, and Jupyter shows them beside a plot."""

    is_map: ClassVar[bool] = True  # whether it is drawn in metres of a world

    @abstractmethod
    def summarize(self) -> dict[str, str]:
        """Summarize the object: for each name, a value with its unit as text."""

    @abstractmethod
    def _draw(self, axes: "Axes") -> None:
        """Draw it in axes; maps in metres of the axes' world (`move_to_axes`)."""

    def plot(self, ax: "Axes | None" = None) -> "Axes":
        """Draw the object in matplotlib axes; maps in metres, x east and y north.

        Axes keep the world of what is drawn in them first; what lies in another world is moved
        there. So an AIM and tracks with different origins come to lie on each other:

            ax = aim.plot()
            tracks.plot(ax)

        Args:
            ax: where to draw; None: a new figure.

        Returns:
            The axes.

        Raises:
            GeoreferenceError: only one of the axes' world and the object's world has a CRS.
        """
        from geoaim.base.map_axes import add_legend, add_scale_bar

        if ax is None:
            from matplotlib import pyplot

            _, ax = pyplot.subplots(figsize=(9, 6), layout="constrained")
        self._draw(ax)
        if self.is_map:
            add_scale_bar(ax)
            add_legend(ax)
        return ax

    def __repr__(self) -> str:
        facts = [f"{name} {value}" for name, value in self.summarize().items()]
        return f"<{type(self).__name__}: {'; '.join(facts[:4])}>"

    def _repr_html_(self) -> str:
        from matplotlib.figure import Figure

        figure = Figure(figsize=THUMBNAIL_INCHES, layout="constrained")
        self.plot(figure.add_subplot())
        content = io.BytesIO()
        figure.savefig(content, dpi=THUMBNAIL_DPI, format="png")
        picture = base64.b64encode(content.getvalue()).decode()
        cell = '<td style="text-align:left">'
        rows = "".join(
            f"<tr>{cell}{escape(name)}</td>{cell}{escape(value)}</td></tr>"
            for name, value in self.summarize().items()
        )
        name = escape(type(self).__name__)
        return (
            f'<div style="display:flex;align-items:flex-start;gap:1em"><img alt="{name}" '
            f'src="data:image/png;base64,{picture}"><table><caption><b>{name}</b></caption>'
            f"{rows}</table></div>"
        )
