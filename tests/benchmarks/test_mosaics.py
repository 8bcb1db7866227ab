import numpy as np

from benchmarks.alignment.mosaics import displace_parts, summarize_chains, summarize_mosaics
from geoaim.base.geometry import transform_points
from tests.imagery.alignment.alignment_pairs import as_aim


def test_parts_are_displaced_by_their_shifts():
    """A bright square in each half; east is to the right, north is up."""
    image = np.zeros((60, 100, 3), np.uint8)
    image[28:32, 23:27] = image[28:32, 73:77] = 200
    picture = as_aim(image, np.array([[0.5, 0, 0], [0, -0.5, 0], [0, 0, 1.0]]))
    shifts = np.array([[3.0, 1.0], [-2.0, 0.0]])
    mosaic, labels = displace_parts(picture, (1, 2), shifts)
    np.testing.assert_array_equal(np.unique(labels), [1, 2])
    for number, shift, column in ((1, shifts[0], 25), (2, shifts[1], 75)):
        v, u = np.nonzero((mosaic.image[..., 0] > 100) & (labels == number))
        found = np.array([[u.mean() + 0.5, v.mean() + 0.5]])
        places = transform_points(picture.world_from_image, np.vstack([found, [[column, 30.0]]]))
        np.testing.assert_allclose(places[0] - places[1], shift, atol=1e-9)


def test_summaries_count_what_is_sure_and_wrong():
    known = {"one file": False, "refused": "", "parts": 2}
    rows = [
        {**known, "errors_m": [0.1, 5.0], "inside": [1.0, 0.0]},
        {**known, "errors_m": [4.0], "inside": [1.0]},
        {**known, "errors_m": [], "inside": [], "refused": "too little"},
    ]
    [row] = summarize_mosaics(rows)
    assert (row["mosaics"], row["refused"], row["sure and wrong"]) == (3, 1, 1)
    assert row["files"] == "a file for each part"
    chains = [
        {"link": link, "refused": "", "error_m": 1.0, "inside": inside}
        for link, inside in ((1, True), (1, False), (2, True))
    ]
    one, two = summarize_chains(chains)
    assert (one["in the 95 % region, %"], two["in the 95 % region, %"]) == (50.0, 100.0)
