import numpy as np
import pytest

from geoaim.base.errors import TracksError
from geoaim.tracks.formats import read_highd, read_ind

IND = (
    "recordingId,trackId,frame,trackLifetime,xCenter,yCenter,heading,width,length,xVelocity,"
    "yVelocity,xAcceleration,yAcceleration,lonVelocity,latVelocity,lonAcceleration,"
    "latAcceleration\n"
)
IND_META = "recordingId,trackId,initialFrame,finalFrame,numFrames,width,length,class\n"
IND_RECORDING = (
    "recordingId,locationId,frameRate,speedLimit,weekday,startTime,duration,numTracks,numVehicles,"
    "numVRUs,latLocation,lonLocation,xUtmOrigin,yUtmOrigin,orthoPxToMeter\n"
)
HIGHD = (
    "frame,id,x,y,width,height,xVelocity,yVelocity,xAcceleration,yAcceleration,"
    "frontSightDistance,backSightDistance,dhw,thw,ttc,precedingXVelocity,precedingId,followingId,"
    "leftPrecedingId,leftAlongsideId,leftFollowingId,rightPrecedingId,rightAlongsideId,"
    "rightFollowingId,laneId\n"
)
HIGHD_META = (
    "id,width,height,initialFrame,finalFrame,numFrames,class,drivingDirection,traveledDistance,"
    "minXVelocity,maxXVelocity,meanXVelocity,minDHW,minTHW,minTTC,numLaneChanges\n"
)
HIGHD_RECORDING = (
    "id,frameRate,locationId,speedLimit,month,weekDay,startTime,duration,totalDrivenDistance,"
    "totalDrivenTime,numVehicles,numCars,numTrucks,upperLaneMarkings,lowerLaneMarkings\n"
)


def _write_ind(folder, name="07"):
    """A car southwards, the same in reverse, a pedestrian eastwards and a cyclist as points."""
    rows = []
    for k in range(5):
        rows += [
            f"7,0,{k},{k},50.0,{-20 - 0.4 * k},270.0,1.8,4.4,0.0,-10.0,0,0,10.0,0,0,0",
            f"7,1,{k},{k},60.0,{-20 + 0.08 * k},270.0,1.8,4.4,0.0,2.0,0,0,-2.0,0,0,0",
            f"7,2,{k},{k},{70 + 0.06 * k},-5.0,0.0,0.0,0.0,1.5,0.0,0,0,1.5,0,0,0",
            f"7,3,{k},{k},{80 + 0.2 * k},-5.0,360.0,0.0,0.0,5.0,0.0,0,0,5.0,0,0,0",
        ]
    classes = ("car", "truck_bus", "pedestrian", "bicycle")
    meta = [f"7,{k},0,4,5,1.8,4.4,{kind}" for k, kind in enumerate(classes)]
    place = "7,1,25.0,13.88,tuesday,14,1210.4,4,2,2,50.782,6.07,293487.1224,5629711.58163,0.00814"
    for kind, head, lines in (
        ("tracks", IND, rows),
        ("tracksMeta", IND_META, meta),
        ("recordingMeta", IND_RECORDING, [place]),
    ):
        (folder / f"{name}_{kind}.csv").write_text(head + "\n".join(lines) + "\n")
    return folder / f"{name}_tracks.csv"


def _write_highd(folder, slow=0.0):
    """A car to the left on the upper carriageway, a truck to the right, a car that hardly moves."""
    tail = "0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0"
    rows = []
    for k in range(1, 4):
        rows += [
            f"{k},1,{400 - 1.2 * k},8.0,4.0,2.0,-30.0,0.0,{tail}",
            f"{k},2,{10 + k},24.0,12.0,2.5,25.0,1.0,{tail}",
            f"{k},3,200.0,12.0,4.0,2.0,{slow},0.0,{tail}",
        ]
    meta = [
        f"{k},4.0,2.0,1,3,3,{kind},{direction},3,1,1,1,1,1,1,0"
        for k, kind, direction in ((1, "Car", 1), (2, "Truck", 2), (3, "Car", 1))
    ]
    recording = "1,25,2,-1.0,9.2017,Tue,08:38,900.54,1,1,3,2,1,8.51;12.59;16.43,21.00;24.96;28.80"
    for kind, head, lines in (
        ("tracks", HIGHD, rows),
        ("tracksMeta", HIGHD_META, meta),
        ("recordingMeta", HIGHD_RECORDING, [recording]),
    ):
        (folder / f"01_{kind}.csv").write_text(head + "\n".join(lines) + "\n")
    return folder / "01_tracks.csv"


def test_ind_is_read_in_utm_metres_radians_and_seconds(tmp_path):
    tracks = read_ind(_write_ind(tmp_path))
    assert tracks.world.crs == "EPSG:32632"
    assert tracks.world.origin == (293487.1224, 5629711.58163)
    assert tracks.types == ("car", "truck", "pedestrian", "cyclist")
    np.testing.assert_allclose(tracks.times, np.arange(5) / 25)
    np.testing.assert_allclose(tracks.states[0, 0], [50, -20, -np.pi / 2, 10])
    np.testing.assert_allclose(tracks.states[3, :, 2], 0, atol=1e-12)


def test_ind_reverses_with_a_negative_speed(tmp_path):
    tracks = read_ind(_write_ind(tmp_path))
    np.testing.assert_allclose(tracks.states[1, :, 2:], [[-np.pi / 2, -2.0]] * 5)


def test_ind_gives_points_the_size_of_their_type(tmp_path):
    sizes = read_ind(_write_ind(tmp_path)).sizes
    np.testing.assert_allclose(sizes, [[4.4, 1.8], [4.4, 1.8], [0.5, 0.5], [1.8, 0.65]])


def test_highd_is_read_as_box_middles_with_y_up_and_headings_of_the_motion(tmp_path):
    tracks = read_highd(_write_highd(tmp_path))
    assert tracks.world.crs is None
    assert tracks.types == ("car", "truck", "car")
    np.testing.assert_allclose(tracks.times, [0.04, 0.08, 0.12])
    np.testing.assert_allclose(tracks.states[0, 0], [400.8, -9.0, -np.pi, 30.0])
    np.testing.assert_allclose(tracks.states[1, 0], [17.0, -25.25, -np.arctan(0.04), np.sqrt(626)])
    np.testing.assert_allclose(tracks.sizes[1], [12.0, 2.5])


@pytest.mark.parametrize("slow", [0.0, 0.4])
def test_highd_agents_that_hardly_move_head_along_the_carriageway(tmp_path, slow):
    tracks = read_highd(_write_highd(tmp_path, slow))
    np.testing.assert_allclose(tracks.states[2, :, 2], -np.pi)


@pytest.mark.parametrize("kind", ["tracksMeta", "recordingMeta"])
@pytest.mark.parametrize(("read", "write"), [(read_ind, _write_ind), (read_highd, _write_highd)])
def test_recording_without_one_of_its_tables_is_refused(tmp_path, read, write, kind):
    path = write(tmp_path)
    next(tmp_path.glob(f"*_{kind}.csv")).unlink()
    with pytest.raises(TracksError, match=f"has no .*_{kind}.csv beside it; keep"):
        read(path)


def test_tables_that_contradict_each_other_are_refused(tmp_path):
    path = _write_ind(tmp_path)
    meta = tmp_path / "07_tracksMeta.csv"
    meta.write_text(meta.read_text().replace("7,3,", "7,9,"))
    with pytest.raises(TracksError, match="'3' is not in its tracksMeta"):
        read_ind(path)
    with pytest.raises(TracksError, match="lacks the columns id, x, y"):
        read_highd(path)
    recording = tmp_path / "07_recordingMeta.csv"
    recording.write_text(recording.read_text().replace("25.0", "0"))
    meta.write_text(meta.read_text().replace("7,9,", "7,3,"))
    with pytest.raises(TracksError, match=r"frameRate of 0.0 is not positive"):
        read_ind(path)


def test_highd_direction_is_one_of_two(tmp_path):
    path = _write_highd(tmp_path)
    meta = tmp_path / "01_tracksMeta.csv"
    meta.write_text(meta.read_text().replace("Truck,2", "Truck,3"))
    with pytest.raises(TracksError, match="drivingDirection '3' is neither"):
        read_highd(path)
