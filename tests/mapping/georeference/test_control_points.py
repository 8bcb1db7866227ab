from dataclasses import replace

import numpy as np
import pytest
from pyproj import CRS
from rasterio.control import GroundControlPoint

from geoaim.base.errors import GeoreferenceError
from geoaim.mapping.georeference.control_points import merge_observations, read_control_points

PIXELS = [[100.5, 200.25], [1800.0, 150.0], [1700.0, 1000.0]]
UTM = [[235269.88, 3811198.11], [235262.54, 3811203.5], [235248.03, 3811227.25]]


def written(tmp_path, text, name="points.csv"):
    path = tmp_path / name
    path.write_text(text)
    return path


@pytest.mark.parametrize("header", ["u,v,x,y", "pixel_x,pixel_y,easting,northing", "col,row,x,y"])
@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_csv_with_each_header(tmp_path, header, separator):
    lines = [f"{u},{v},{x},{y}" for (u, v), (x, y) in zip(PIXELS, UTM, strict=True)]
    text = "\n".join([header, *lines]).replace(",", separator)
    points = read_control_points(written(tmp_path, f"# crs: EPSG:32611\n{text}\n"))
    np.testing.assert_array_equal(points.pixels, PIXELS)
    np.testing.assert_array_equal(points.coordinates, UTM)
    assert points.crs == "EPSG:32611"
    assert points.names == ("point 1", "point 2", "point 3")
    assert points.frames == (None, None, None)


def test_csv_in_degrees_needs_no_crs_and_keeps_names_and_frames(tmp_path):
    text = "name,frame,lon,lat,u,v\nkerb,12,27.5,53.9,10,20\nmanhole,a.jpg,27.51,53.91,30,40\n"
    points = read_control_points(written(tmp_path, text))
    assert points.crs == "EPSG:4326"
    assert points.names == ("kerb", "manhole")
    assert points.frames == (12, "a.jpg")
    np.testing.assert_array_equal(points.coordinates[0], [27.5, 53.9])


def test_csv_states_the_accuracy_of_its_coordinates(tmp_path):
    text = "# accuracy: {}\nname,u,v,lon,lat\na,10,20,27.5,53.9\n"
    assert read_control_points(written(tmp_path, text.format("0.6 m"))).accuracy == 0.6
    for wrong in ("good", "-1", "nan"):
        with pytest.raises(GeoreferenceError, match="line 1: "):
            read_control_points(written(tmp_path, text.format(wrong)))


def test_csv_with_a_column_of_crs(tmp_path):
    text = "u,v,x,y,crs\n1,2,3,4,EPSG:32635\n5,6,7,8,32635\n"
    assert read_control_points(written(tmp_path, text)).crs == "EPSG:32635"


def test_mixed_crs_is_refused(tmp_path):
    text = "u,v,x,y,crs\n1,2,3,4,EPSG:32635\n5,6,7,8,EPSG:32636\n"
    with pytest.raises(GeoreferenceError, match=r"EPSG:32635, EPSG:32636"):
        read_control_points(written(tmp_path, text))


def test_an_argument_against_the_file_is_refused(tmp_path):
    path = written(tmp_path, "# crs: EPSG:32635\nu,v,x,y\n1,2,3,4\n")
    with pytest.raises(GeoreferenceError, match="different CRSs"):
        read_control_points(path, crs="EPSG:32636")


def test_metres_without_a_crs_are_refused_and_local_is_said(tmp_path):
    path = written(tmp_path, "u,v,x,y\n1,2,3,4\n")
    with pytest.raises(GeoreferenceError, match="no coordinate reference system"):
        read_control_points(path)
    assert read_control_points(path, crs="local").crs is None


@pytest.mark.parametrize("bad", ["abc", "nan", "inf", ""])
def test_a_bad_number_is_named_by_its_line(tmp_path, bad):
    path = written(tmp_path, f"u,v,lon,lat\n1,2,3,4\n\n5,6,{bad},8\n")
    with pytest.raises(GeoreferenceError, match="line 4"):
        read_control_points(path)


@pytest.mark.parametrize(
    "crs", ["EPSG:32611", "WGS84 UTM 11N", "+proj=utm +zone=11 +datum=WGS84 +units=m +no_defs"]
)
def test_opendronemap_pixels_gain_half_a_pixel(tmp_path, crs):
    text = (
        f"{crs}\n235269.88\t3811198.11\t0.0\t100\t200\tIMG_1.jpg\tgcp 02\n# no\n1 2 3 4 5 b.jpg\n"
    )
    points = read_control_points(written(tmp_path, text, "gcp_list.txt"))
    np.testing.assert_array_equal(points.pixels[0], [100.5, 200.5])
    assert points.crs == "EPSG:32611"
    assert points.frames == ("IMG_1.jpg", "b.jpg")
    assert points.names == ("gcp 02", "point 2")


def test_opendronemap_lists_without_pixels_are_refused(tmp_path):
    path = written(tmp_path, "EPSG:4326\ngcp01\t-119.87\t34.40\t0\n")
    with pytest.raises(GeoreferenceError, match=r"line 2.*4 fields"):
        read_control_points(path)
    with pytest.raises(GeoreferenceError, match="no column"):
        read_control_points(written(tmp_path, "3483\t729\tIMG_0031.jpg\n", "b.txt"))


@pytest.mark.parametrize("names", ["pixelX,pixelY,enable", "sourceX,sourceY,enable,dX,dY,residual"])
def test_qgis_points_turn_their_sign_and_skip_disabled(tmp_path, names):
    text = f"#CRS: EPSG:32635\nmapX,mapY,{names}\n5,6,100.5,-200.5,1,0,0,0\n7,8,1,-1,0,0,0,0\n"
    points = read_control_points(written(tmp_path, text, "a.points"))
    np.testing.assert_array_equal(points.pixels, [[100.5, 200.5]])
    np.testing.assert_array_equal(points.coordinates, [[5.0, 6.0]])
    assert points.crs == "EPSG:32635"


def test_qgis_points_have_their_crs_in_a_column(tmp_path):
    crs = CRS("EPSG:32635").to_wkt("WKT1_GDAL").replace('"', '""')  # as of QGIS 3.18 to 3.24
    text = f'mapX,mapY,pixelX,pixelY,enable,CRS\n5,6,100.5,-200.5,1,"{crs}"\n'
    points = read_control_points(written(tmp_path, text, "a.points"))
    np.testing.assert_array_equal(points.coordinates, [[5.0, 6.0]])
    assert points.crs is not None
    assert CRS(points.crs).equals("EPSG:32635", True)


def test_qgis_points_of_a_georeferenced_picture_are_refused(tmp_path):
    text = "mapX,mapY,sourceX,sourceY,enable\n5,6,100.5,200.5,1\n"
    with pytest.raises(GeoreferenceError, match=r"line 2.*positive image y"):
        read_control_points(written(tmp_path, text), crs="EPSG:32635")


def test_rasterio_points_are_row_and_column():
    gcps = [GroundControlPoint(row=20.5, col=10.5, x=5.0, y=6.0, id="a")]
    points = read_control_points(gcps, crs="EPSG:32635")
    np.testing.assert_array_equal(points.pixels, [[10.5, 20.5]])
    assert points.names == ("a",)
    with pytest.raises(GeoreferenceError, match="no coordinate reference system"):
        read_control_points(gcps)


def test_mappings_and_pairs():
    pairs = read_control_points([((10, 20), (27.5, 53.9))])
    mappings = read_control_points([{"u": 10, "v": 20, "lon": 27.5, "lat": 53.9, "name": "a"}])
    np.testing.assert_array_equal(pairs.pixels, mappings.pixels)
    assert pairs.crs == mappings.crs == "EPSG:4326"
    assert mappings.names == ("a",)


def test_nothing_and_nonsense_are_refused(tmp_path, unchecked):
    with pytest.raises(GeoreferenceError, match="no control points"):
        read_control_points(written(tmp_path, "\n# only a remark\n"))
    with pytest.raises(GeoreferenceError, match="cannot be read"):
        read_control_points(tmp_path / "missing.csv")
    with pytest.raises(GeoreferenceError, match=r"field larger .*close the quotation mark that is"):
        read_control_points(written(tmp_path, 'u,v,x,y\n1,2,3,"' + 140_000 * "9"))
    with pytest.raises(TypeError, match="pair"):
        read_control_points([3, 4])


def test_one_place_seen_on_two_frames_becomes_one_point():
    points = read_control_points(
        [{"u": u, "v": 5, "lon": x, "lat": 1, "frame": f} for u, x, f in
         [(10, 1, "a"), (12, 1, "b"), (50, 2, "a")]]
    )  # fmt: skip
    merged = merge_observations(points)
    np.testing.assert_array_equal(merged.pixels, [[11.0, 5.0], [50.0, 5.0]])
    same = merge_observations(replace(points, frames=("a", "a", "a")))
    assert len(same.names) == 3


SPREADSHEET = [
    "# crs: EPSG:32611{0}",
    '"# accuracy: 0.05"{0}',
    "name,u,v,x,y",
    "kerb,100.5,200.25,235269.88,3811198.11",
    ",,,,",
]


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_what_a_spreadsheet_saves_is_read(tmp_path, separator, encoding):
    text = "\n".join(["sep=,", *SPREADSHEET]).format(",,,,").replace(",", separator)
    (tmp_path / "a.csv").write_bytes(text.encode(encoding))
    points = read_control_points(tmp_path / "a.csv")
    assert (points.crs, points.accuracy, points.names) == ("EPSG:32611", 0.05, ("kerb",))
    np.testing.assert_array_equal(points.coordinates, UTM[:1])


def test_text_of_another_encoding_says_what_to_do(tmp_path):
    (tmp_path / "a.csv").write_bytes("name,u,v,lon,lat\nStraße,1,2,3,4\n".encode("latin-1"))
    with pytest.raises(GeoreferenceError, match="save it as UTF-8"):
        read_control_points(tmp_path / "a.csv")


@pytest.mark.parametrize(
    ("header", "crs"),
    [
        ("WGS84 UTM 35N", "EPSG:32635"),
        ("WGS84 UTM 35 S", "EPSG:32735"),
        ("wgs84 utm 35n", "EPSG:32635"),
        ("WGS84 UTM 35U", "EPSG:32635"),  # a band of latitude
        ("WGS84 UTM 35H", "EPSG:32735"),
        ("WGS 84 / UTM zone 35N", "EPSG:32635"),
        ("WGS_1984_UTM_Zone_35N", "EPSG:32635"),
        ("EPSG:32635", "EPSG:32635"),
        ("epsg: 32635", "EPSG:32635"),
        ("EPSG 32635", "EPSG:32635"),
        ("WGS84", "EPSG:4326"),
        ("'+proj=utm +zone=35 +datum=WGS84 +units=m +no_defs +type=crs'", "EPSG:32635"),
    ],
)
def test_headers_of_opendronemap_in_common_spellings(tmp_path, header, crs):
    rows = "583193.6 6062228.2 120 767.4 312.4 a.jpg kerb\n" * 2
    points = read_control_points(written(tmp_path, f"{header}\n{rows}", "gcp_list.txt"))
    assert points.crs == crs
    np.testing.assert_allclose(points.pixels[0], [767.9, 312.9])
    assert points.frames[0] == "a.jpg"


def test_points_may_be_switched_off_and_have_an_accuracy(tmp_path):
    text = "name,enable,accuracy,u,v,lon,lat\na,1,0.02,1,2,27.5,53.9\nb,0,9,3,4,27.6,53.8\n"
    points = read_control_points(written(tmp_path, text))
    assert (points.names, points.accuracy) == (("a",), 0.02)


@pytest.mark.parametrize("separator", [";", "\t"])
def test_decimal_commas_are_read_where_they_separate_nothing(tmp_path, separator):
    lines = [["u", "v", "x", "y", "accuracy"], ["10,5", "20", "583200,25", "-6062200,5", "0,3"]]
    path = tmp_path / "points.csv"
    path.write_text("# crs: local\n" + "\n".join(separator.join(line) for line in lines))
    points = read_control_points(path)
    np.testing.assert_array_equal(points.pixels, [[10.5, 20.0]])
    np.testing.assert_array_equal(points.coordinates, [[583200.25, -6062200.5]])
    assert points.accuracy == 0.3


def test_commas_of_thousands_are_refused(tmp_path):
    path = tmp_path / "points.csv"
    path.write_text('# crs: local\nu,v,x,y\n10,20,"583,200","6,062,200"\n')
    with pytest.raises(GeoreferenceError, match="line 3"):
        read_control_points(path)


def test_a_workbook_is_refused_with_what_to_do(tmp_path):
    (tmp_path / "points.xlsx").write_bytes(b"PK" + bytes(50))
    with pytest.raises(GeoreferenceError, match=r"points\.xlsx.*save the sheet as CSV"):
        read_control_points(tmp_path / "points.xlsx")


def test_a_first_cell_may_be_empty_where_tabs_separate(tmp_path):
    path = written(tmp_path, "name\tu\tv\tlon\tlat\n\t1\t2\t27.5\t53.9\n")
    np.testing.assert_array_equal(read_control_points(path).pixels, [[1.0, 2.0]])


def test_a_line_of_accuracy_may_have_a_decimal_comma(tmp_path):
    path = written(tmp_path, "# accuracy: 0,05 m\nu;v;lon;lat\n1;2;27,5;53,9\n")
    assert read_control_points(path).accuracy == 0.05


def test_qgis_column_of_crs_and_commas_of_opendronemap_are_read(tmp_path):
    wkt = CRS.from_epsg(32611).to_wkt("WKT1_GDAL").replace('"', '""')
    lines = [
        f'{x},{y},{u},{-v},1,0,0,0,"{wkt}"' for (u, v), (x, y) in zip(PIXELS, UTM, strict=True)
    ]
    qgis = tmp_path / "a.points"
    qgis.write_text("\n".join(["mapX,mapY,pixelX,pixelY,enable,dX,dY,residual,CRS", *lines]))
    assert read_control_points(qgis).crs == "EPSG:32611"
    lines = [f"{x},{y},181.2,{u},{v},a.jpg" for (u, v), (x, y) in zip(PIXELS, UTM, strict=True)]
    drone = tmp_path / "gcp_list.txt"
    drone.write_text("\n".join(["EPSG:32611", *lines]))
    np.testing.assert_allclose(read_control_points(drone).coordinates, UTM)
