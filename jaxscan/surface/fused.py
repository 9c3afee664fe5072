"""One surface of what a scan saw several times, as a turn does (`jaxscan.surface.passages`)."""

from jaxscan.geometry import Pose
from jaxscan.reconstruction import RangeImage
from jaxscan.surface.links import Sampling, sampling
from jaxscan.surface.merged import Merged, merge
from jaxscan.surface.side import side_of_surface
from jaxscan.surface.triangles import grid_layers


def fused(image: RangeImage, how: Sampling | None = None) -> Merged:
    """The layers of all passages as one surface, each point by its σ, as `merge` joins scans.

    Args:
        image: the range image.
        how: its spacing and noise; by default as `sampling` finds them.

    Raises:
        InputError: there are too few points, or no surface comes of them.
    """
    how = how or sampling(image)
    layers = grid_layers(image, how)
    sides = [side_of_surface(f"passage {i}", image, layer, how) for i, layer in enumerate(layers, 1)]
    return merge(sides, [Pose.identity()] * len(sides))
