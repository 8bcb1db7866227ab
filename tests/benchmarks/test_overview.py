"""The picture of all stages is drawn from the published results."""

from benchmarks.overview import PANELS, draw_stages


def test_each_stage_has_ours_and_another_method() -> None:
    panels = {panel.title: list(panel.read()) for panel in PANELS}
    for panel in PANELS:
        names = [name for name, *_ in panels[panel.title]]
        assert panel.ours in names
        assert len(names) > 1
    figure = draw_stages(PANELS)
    assert [axes.get_title() for axes in figure.axes] == list(panels)
