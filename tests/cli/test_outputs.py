import pytest
from typer.testing import CliRunner

from geoaim.cli import app

run = CliRunner().invoke


@pytest.mark.parametrize(
    "given",
    [
        ["align", "shot.png", "--points", "points.csv", "-o", "shot.tif"],
        ["align", "*.png", "-o", "shot.tif"],
        ["align", "tiles", "-o", "tiles/19/7.tif"],
        ["align", "other.tif", "--points", "points.tif", "-o", "points.tif"],
        ["align", "other.tif", "--points", "shot.png", "-o", "shot.tif"],
        ["build", "shot.png", "--points", "points.csv", "-o", "shot.tif"],
        ["build", "tiles/19", "-o", "tiles/19/7.tif"],
        ["build", "other.mp4", "--points", "points.tif", "-o", "points.tif"],
    ],
)
def test_neither_map_nor_quick_look_replaces_an_input(tmp_path, monkeypatch, given):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiles" / "19").mkdir(parents=True)
    for name in ("shot.png", "points.tif", "points.csv", "tiles/19/7.png"):
        (tmp_path / name).write_text(name)
    result = run(app, given)
    assert result.exit_code == 1
    output = " ".join(result.output.split())
    assert "would replace the input" in output or "is also an input" in output
    assert (tmp_path / given[-1]).exists() == (given[-1] == "points.tif")
    for name in ("shot.png", "points.tif", "points.csv", "tiles/19/7.png"):
        assert (tmp_path / name).read_text() == name


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["draw", "samples/map.osm", "-o", "a.png"], "ends in .tif or .tiff"),
        (["draw", "a.tif", "-o", "a.tif"], "is also an input"),
        (["draw", "samples/map.osm", "--aim", "a.tif", "-o", "./a.tif"], "is also an input"),
        (["render", "a.tif", "--tracks", "t", "--ego", "1", "-o", "a.avi"], "ends in .mp4"),
        (["simulate", "a.tif", "--tracks", "t", "-o", "a.txt"], "ends in .csv or .parquet"),
        (["simulate", "a.tif", "--tracks", "t.csv", "-o", "t.csv"], "is also an input"),
        (["texture", "a.tif", "pyproject.toml/a"], "is a file; a folder is needed"),
        (["sample", "pyproject.toml/a"], "is a file; a folder is needed"),
        (
            ["simulate", "a.tif", "--tracks", "t", "-o", "o.csv", "--film", "f.png"],
            "ends in .mp4 or .gif",
        ),
        (
            ["simulate", "a.tif", "--tracks", "t", "-o", "o.csv", "--stop-lines", "l.geojson"],
            "--stop-lines needs --lights",
        ),
    ],
)
def test_wrong_suffixes_and_outputs_that_are_inputs_are_refused_before_the_work(options, message):
    result = run(app, options)
    assert result.exit_code == 1
    assert message in " ".join(result.output.split())


@pytest.mark.parametrize("name", ["map.tif", "tracks.csv"])
def test_files_of_a_folder_of_place_are_not_replaced_one_by_one(tmp_path, name):
    for written in ("map.tif", "report.json", "tracks.csv"):
        (tmp_path / written).write_text(written)
    output = tmp_path / name
    command = ["build", "v.mp4"] if name == "map.tif" else ["convert", "t.csv"]
    result = run(app, [*command, "-o", str(output)])
    assert result.exit_code == 1
    assert "belongs to a folder of geoaim place" in " ".join(result.output.split())
    assert output.read_text() == name
    (tmp_path / "report.json").unlink()  # a folder of somebody's own
    result = run(app, [*command, "-o", str(output)])
    assert "belongs to" not in result.output


@pytest.mark.parametrize("command", ["sample {}", "texture a.tif {}", "frame v.mp4 -o {}/a.png"])
def test_folder_without_permission_is_named_before_the_work(monkeypatch, tmp_path, command):
    monkeypatch.setattr("os.access", lambda *_: False)  # root may write everywhere
    result = run(app, command.format(tmp_path / "new").split())
    assert result.exit_code == 1
    assert f"{tmp_path} cannot be written to; choose" in " ".join(result.output.split())
