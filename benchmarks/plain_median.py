"""The plain script of `benchmarks.plain_script`, which imports nothing else.

    python benchmarks/plain_median.py VIDEO PICTURE.png

Registers 32 frames to the first one by ORB and a homography of MAGSAC++, as many scripts do, and
writes their median.
"""

import sys
from typing import Any

import cv2
import numpy as np

FRAMES = 32
BAND = 64  # rows whose median is taken at once: of whole frames it takes longer, and memory


def main(video: str, picture: str) -> None:
    """Write the median of a video's frames."""
    capture: Any = cv2.VideoCapture(video)
    count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    chosen = set(np.linspace(0, count - 1, FRAMES).round().astype(int).tolist())
    orb, matcher = cv2.ORB.create(2000), cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
    first: Any = None
    warped: list[Any] = []
    for index in range(count):
        if not capture.grab() or index not in chosen:
            continue
        _, bgr = capture.retrieve()
        points, descriptors = orb.detectAndCompute(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY), None)
        first = first or (points, descriptors)
        pairs = matcher.match(descriptors, first[1])
        source = np.array([points[pair.queryIdx].pt for pair in pairs])
        target = np.array([first[0][pair.trainIdx].pt for pair in pairs])
        matrix, _ = cv2.findHomography(source, target, cv2.USAC_MAGSAC, 2.0)
        warped.append(cv2.warpPerspective(bgr, matrix, bgr.shape[1::-1]))
    median = np.empty_like(warped[0])
    for row in range(0, len(median), BAND):
        rows = np.stack([image[row : row + BAND] for image in warped], axis=-1)
        median[row : row + BAND] = np.median(rows, axis=-1)
    cv2.imwrite(picture, median)


if __name__ == "__main__":
    main(*sys.argv[1:])
