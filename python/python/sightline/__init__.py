"""Results of Sightline: view cells, and what is visible from each.

    import sightline
    pvs = sightline.Pvs("level.pvs")          # checks all of the file
    ids = pvs.visible((1.5, 2.0, -3.0))       # numpy array of triangle ids, ascending
    ids = pvs.visible(37)                     # the same of a cell
"""

from ._sightline import Error, Pvs

__all__ = ["Error", "Pvs"]
