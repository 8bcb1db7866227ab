import numpy as np
import pytest

from geoaim.base.errors import TracksError
from geoaim.tracks.formats import read_sind
from geoaim.tracks.formats.motion import estimate_velocity

VEHICLES = (
    "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,yaw_rad,heading_rad,length,width,ax,ay,"
    "v_lon,v_lat,a_lon,a_lat\n"
)
PEDESTRIANS = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,ax,ay\n"


def _write(folder):
    vehicles = "1,0,0.0,car,5,6,0,3,1.5708,1.5708,4.5,1.8,0,0,3,0,0,0\n"
    vehicles += "1,1,100.1001,car,5,6.3,0,3,1.5708,1.5708,4.5,1.8,0,0,3,0,0,0\n"
    vehicles += "2,1,100.1001,bicycle,5,9,0,-0.5,1.5708,-1.5708,1.7,0.6,0,0,-0.5,0,0,0\n"
    (folder / "Veh_smoothed_tracks.csv").write_text(VEHICLES + vehicles)
    (folder / "Ped_smoothed_tracks.csv").write_text(
        PEDESTRIANS + "P1,0,0.0,pedestrian,1,2,-1,0,0,0\n"
    )


def test_folder_of_a_recording_gives_vehicles_and_pedestrians_together(tmp_path):
    _write(tmp_path)
    tracks = read_sind(tmp_path)
    assert tracks.ids == ("1", "2", "P1")
    assert tracks.types == ("car", "cyclist", "pedestrian")
    np.testing.assert_allclose(tracks.times, [0, 0.1001001], atol=1e-6)
    np.testing.assert_allclose(tracks.states[0, 0], [5, 6, 1.5708, 3])
    np.testing.assert_allclose(tracks.states[2, 0], [1, 2, -np.pi, 1])
    np.testing.assert_allclose(tracks.sizes, [[4.5, 1.8], [1.7, 0.6], [0.5, 0.5]])


def test_a_vehicle_in_reverse_keeps_its_heading_and_has_a_negative_speed(tmp_path):
    _write(tmp_path)
    tracks = read_sind(tmp_path / "Veh_smoothed_tracks.csv")
    np.testing.assert_allclose(tracks.states[1, 1, 2:], [1.5708, -0.5])


def test_folder_without_the_files_and_vehicles_without_yaw_are_refused(tmp_path):
    with pytest.raises(TracksError, match=r"has neither Veh_smoothed_tracks.csv nor Ped_"):
        read_sind(tmp_path)
    path = tmp_path / "Veh_smoothed_tracks.csv"
    path.write_text(PEDESTRIANS + "1,0,0,car,1,2,-1,0,0,0\n")
    with pytest.raises(TracksError, match="lacks the columns yaw_rad"):
        read_sind(path)


@pytest.mark.parametrize(("place", "agents"), [("Changchun", 49), ("Chongqing", 40)])
def test_real_pedestrians_head_along_their_motion(data_folder, place, agents):
    folder = next((data_folder / "tracks/sind" / place).glob("*/Ped_smoothed_tracks.csv")).parent
    tracks = read_sind(folder)
    assert len(tracks.ids) == agents
    velocity = estimate_velocity(tracks, 0.25, 0.25)
    moving = tracks.present & (np.hypot(*np.moveaxis(velocity, -1, 0)) > 1)
    turn = np.arctan2(velocity[..., 1], velocity[..., 0]) - tracks.states[..., 2]
    off = np.angle(np.exp(1j * turn[moving]))
    assert abs(np.median(off)) < np.radians(0.1)
    assert np.percentile(np.abs(off), 95) < np.radians(15)
