"""Link overlapping photos of a flight where no photo overlaps with all others."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse.csgraph import dijkstra

from geoaim.base.geometry import transform_points
from geoaim.mapping.registration.features import detect_features, match_features
from geoaim.mapping.registration.frame_registration import mask_detections
from geoaim.mapping.video.detections import Detections
from geoaim.mapping.video.video import Video

STEP_LENGTH = 0.3  # added for each link, in image diagonals: prefers paths of few links
UNLINKED = -9999  # what SciPy gives as the predecessor where there is no path


@dataclass(frozen=True, eq=False)
class PhotoLinks:
    """Homographies between overlapping photos."""

    # cost of each link: the distance of the photos' centres in image diagonals, plus `STEP_LENGTH`;
    # 0 where two photos are not linked
    lengths: Float[Array, "T T"]
    # (i, j) -> (3, 3) pixels of photo j to those of photo i, for i < j
    transforms: dict[tuple[int, int], Float[Array, "3 3"]]


def link_photos(video: Video, detections: Detections | None) -> PhotoLinks:
    """Match the ORB features of each pair of photos, outside the boxes of detections."""
    features = [
        detect_features(frame.grey, exclude=mask_detections(frame, detections)) for frame in video
    ]
    size = video.height, video.width
    lengths, transforms = np.zeros((len(features),) * 2), {}
    middle = np.array([[video.width / 2, video.height / 2]])
    for one, other in combinations(range(len(features)), 2):
        matrix = match_features(features[one], features[other], "homography", size=size)
        if matrix is None:
            continue
        transforms[one, other] = matrix
        shift = np.linalg.norm(transform_points(matrix, middle) - middle)
        lengths[one, other] = lengths[other, one] = STEP_LENGTH + shift / np.hypot(*size)
    return PhotoLinks(lengths, transforms)


def choose_central_photo(links: PhotoLinks, wanted: list[int]) -> int:
    """Choose the photo that is linked to most of the wanted ones (indices), then the nearest."""
    distance = dijkstra(links.lengths)[:, wanted]
    linked = np.isfinite(distance)
    total = np.where(linked, distance, 0.0).sum(axis=1)
    return int(np.lexsort([total, -linked.sum(axis=1)])[0])


def chain_links(links: PhotoLinks, photo: int, reference: int) -> Float[Array, "3 3"] | None:
    """Compose the transform of a photo to the reference along the shortest path of links."""
    _, previous = dijkstra(links.lengths, indices=reference, return_predecessors=True)
    matrix = np.eye(3)
    while photo != reference:
        nearer = int(previous[photo])
        if nearer == UNLINKED:
            return None
        if nearer < photo:
            matrix = links.transforms[nearer, photo] @ matrix
        else:
            matrix = np.linalg.inv(links.transforms[photo, nearer]) @ matrix
        photo = nearer
    return matrix / matrix[2, 2]
