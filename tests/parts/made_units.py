"""Units whose files are made and read back: a plain one, a narrow hinge, narrow strips."""

from foldlab.making.geometry import Geometry

UNITS = {
    "plain": Geometry(40.0, 10.0, 0.1, 10.0, 10.0, 0.2),
    "narrow": Geometry(61.37, 17.9, 0.37, 7.43, 6.01, 0.119),
    "strips": Geometry(100.0, 25.0, 1.0, 20.0, 15.0, 1.0, strips=7, strip_share=0.6),
}
