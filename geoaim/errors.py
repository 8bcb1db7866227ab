"""Every error that geoaim raises about data; a bad call raises ValueError or TypeError.

GeoaimError
├── VideoError          no frame could be read
├── RegistrationError   too few frames agree with the reference
├── BackgroundError     the registered frames do not give a background
├── GeoreferenceError   the control points or the telemetry do not fix a place
├── AlignmentError      imagery cannot be laid on what it should lie on
├── AimError            a file is not an AIM, or an AIM cannot be written as asked
├── TracksError         a file holds no tracks or lights, or such as contradict themselves
├── MapError            a file is no HD map, or does not lie where it is needed
├── ImageryError        imagery cannot be read, or does not lie where it is needed
└── ModelError          a file is no prediction model, or one of another version

GeoaimWarning           the work went on, with less than was asked for
"""


class GeoaimError(Exception):
    """Data that cannot be used: the message says what was found, what was needed, what to do."""


class VideoError(GeoaimError):
    """No frame could be read."""


class RegistrationError(GeoaimError):
    """Too few frames agree with the reference."""


class BackgroundError(GeoaimError):
    """The registered frames do not give a background."""


class GeoreferenceError(GeoaimError):
    """The control points or the telemetry do not fix a place."""


class AlignmentError(GeoaimError):
    """Imagery cannot be laid on what it should lie on: too little in common, or in two ways."""


class AimError(GeoaimError):
    """A file is not an AIM, or an AIM cannot be written as asked."""


class TracksError(GeoaimError):
    """A file holds no tracks or lights, or such as contradict themselves."""


class MapError(GeoaimError):
    """A file is no HD map, or does not lie where it is needed."""


class ImageryError(GeoaimError):
    """Imagery cannot be read, or does not lie where it is needed."""


class ModelError(GeoaimError):
    """A file is no prediction model, or one of another version."""


class GeoaimWarning(UserWarning):
    """The work went on, with less than was asked for: a damaged file, a skipped point."""
