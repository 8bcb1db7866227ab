"""The tracks of all days of a place, in one file with dates."""

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory

from geoaim.catalog.records import FOLDER, TRACKS, Record
from geoaim.catalog.stac import parse_time
from geoaim.catalog.storage import download, join_address
from geoaim.tracks.changes import to_world
from geoaim.tracks.files import read_plain_tracks, write_dated_tracks
from geoaim.tracks.tracks import Tracks

PLACES = "places"  # folder of a catalogue that has a folder for each place


def group_tracks(records: Sequence[Record]) -> dict[str, list[Record]]:
    """Group the recordings that have tracks by their place, in the order of their dates."""
    places: dict[str, list[Record]] = {}
    tracked = [record for record in records if record.datetime and TRACKS in record.files]
    for record in sorted(tracked, key=lambda record: parse_time(str(record.datetime))):
        if (place := record.choices.get("place")) is not None:
            places.setdefault(place, []).append(record)
    return places


def get_tracks_path(place: str) -> str:
    """Get the path of the tracks of a place in a catalogue."""
    return f"{PLACES}/{place}/{TRACKS}"


def join_tracks(records: Sequence[Record], catalog: str) -> dict[str, bytes]:
    """Join the tracks of each place, as GeoParquet, by their paths in the catalogue."""
    contents = {}
    for place, days in group_tracks(records).items():
        with TemporaryDirectory() as folder:
            parts = dict[str, tuple[Tracks, datetime]]()
            for day in days:
                copy = Path(folder) / f"{day.name}.parquet"
                download(join_address(catalog, FOLDER, day.name, TRACKS), copy)
                tracks = read_plain_tracks(copy)
                world = next(iter(parts.values()))[0].world if parts else tracks.world
                parts[day.name] = to_world(tracks, world), parse_time(str(day.datetime))
            write_dated_tracks(parts, joined := Path(folder) / "joined.parquet")
            contents[get_tracks_path(place)] = joined.read_bytes()
    return contents
