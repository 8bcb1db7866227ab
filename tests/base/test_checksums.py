"""Files of geoaim's own formats: damage is refused, files of earlier versions are read."""

import numpy as np
import pytest
import torch

import geoaim
from geoaim.aim import files as aim_files
from geoaim.aim.files import read_aim, write_aim
from geoaim.base.errors import AimError, GeoaimError, GeoaimWarning, ModelError, TracksError
from geoaim.prediction import checkpoints
from geoaim.prediction.checkpoints import read_model, read_state, write_model
from geoaim.prediction.training import init_model
from geoaim.tracks import files as track_files
from geoaim.tracks.files import read_plain_tracks, write_tracks
from tests.faults.damage import CHECKED, FORMATS, flip_bits

READERS = {
    "aim-3.tif": read_aim,
    "model-2.pt": read_model,
    "model-3.pt": read_model,
    "checkpoint-3.pt": read_state,
    "tracks-1.csv": read_plain_tracks,
    "tracks-1.parquet": read_plain_tracks,
    "tracks-2.parquet": read_plain_tracks,
}
WITHOUT_CHECKSUM = ["model-2.pt", "tracks-1.parquet"]


def read(name: str):
    if name not in WITHOUT_CHECKSUM:
        return READERS[name](FORMATS / name)
    with pytest.warns(GeoaimWarning, match=rf"{name} is of an earlier version .* no checksum"):
        return READERS[name](FORMATS / name)


def test_an_aim_is_read():
    aim = read("aim-3.tif")
    assert aim.world.crs == "EPSG:32635"
    assert aim.image.shape == (12, 16, 3)
    assert aim.image[3, 4].tolist() == [96, 207, 28]
    assert (aim.coverage == 300).all()
    np.testing.assert_array_equal(aim.world_from_image[0], [0.2, 0, 100])
    assert aim.report == {"registration": {"valid": 12}}


@pytest.mark.parametrize("name", ["model-2.pt", "model-3.pt"])
def test_models_of_every_version_are_read(name):
    model = read(name)
    assert (model.config.kind, model.config.hidden_size) == ("pedestrian", 4)
    total = sum(float(weights.double().sum()) for weights in model.state_dict().values())
    assert total == pytest.approx(-0.9520788192749023, abs=1e-9)


@pytest.mark.parametrize("name", ["tracks-1.csv", "tracks-1.parquet", "tracks-2.parquet"])
def test_tracks_of_every_version_are_read(name):
    tracks = read(name)
    assert (tracks.ids, tracks.types) == (("7", "b"), ("car", "pedestrian"))
    np.testing.assert_allclose(tracks.states[0, :, 0], [0.0, 0.2, 0.4])
    assert tracks.world.origin == (583000.0, 6062000.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", CHECKED)
def test_no_flipped_bit_is_accepted(name, tmp_path):
    accepted, unnamed = flip_bits(FORMATS / name, READERS[name], tmp_path)
    assert (accepted, unnamed) == ([], [])


def test_every_version_that_is_written_has_a_file_here():
    newest = {
        f"aim-{aim_files.FORMAT.newest}.tif",
        f"model-{checkpoints.FORMAT.newest}.pt",
        f"checkpoint-{checkpoints.FORMAT.newest}.pt",
        f"tracks-{track_files.CSV.newest}.csv",
        f"tracks-{track_files.PARQUET.newest}.parquet",
    }
    assert newest <= set(READERS) == {path.name for path in FORMATS.iterdir()}


@pytest.mark.slow
@pytest.mark.parametrize("name", CHECKED)
def test_a_file_that_was_cut_or_has_more_bytes_is_refused_by_name(name, tmp_path):
    whole = (FORMATS / name).read_bytes()
    middle = len(whole) * 2 // 3
    for changed in (whole[:-1], whole + b"0", whole[:middle] + b"0" + whole[middle:]):
        (tmp_path / name).write_bytes(changed)
        with pytest.raises(GeoaimError, match=name):
            READERS[name](tmp_path / name)


@pytest.mark.parametrize("name", ["aim-3.tif", "model-3.pt", "tracks-2.parquet"])
def test_files_are_written_as_by_the_version_of_their_name(name, tmp_path):
    write = {"aim": write_aim, "mod": write_model, "tra": write_tracks}[name[:3]]
    write(read(name), tmp_path / name)
    (tmp_path / name).write_bytes(damage := bytearray((tmp_path / name).read_bytes()))
    READERS[name](tmp_path / name)
    damage[len(damage) // 2] ^= 1
    (tmp_path / name).write_bytes(damage)
    with pytest.raises(GeoaimError, match=rf"{name} is damaged"):
        READERS[name](tmp_path / name)


@pytest.mark.parametrize("kind", ["vehicle", "pedestrian"])
def test_pretrained_models_have_a_checksum(kind):
    assert geoaim.prediction.read_pretrained(kind).config.kind == kind  # and warn of nothing


def test_a_model_with_weights_that_are_not_finite_is_refused_by_name(tmp_path):
    model = init_model(read("model-3.pt").config)
    with torch.no_grad():
        next(model.parameters()).view(-1)[0] = torch.nan
    write_model(model, tmp_path / "model.pt")
    with pytest.raises(ModelError, match=r"model\.pt: weights of .* are not finite"):
        read_model(tmp_path / "model.pt")


def test_other_versions_are_refused(tmp_path):
    earlier = (
        (FORMATS / "aim-3.tif").read_bytes().replace(b"format&amp;quot;: 3", b"format&amp;quot;: 2")
    )
    (tmp_path / "a.tif").write_bytes(earlier.replace(b"geoaim-sha256", b"geoaim-sha257"))
    with pytest.raises(AimError, match=r"AIM format 2; this version reads 3: .* `geoaim build`"):
        read_aim(tmp_path / "a.tif")
    text = (FORMATS / "tracks-1.csv").read_text()
    (tmp_path / "a.csv").write_text("# format: 2\n" + text)
    with pytest.raises(TracksError, match=r"a\.csv has tracks format 2; this version reads 1"):
        read_plain_tracks(tmp_path / "a.csv")
