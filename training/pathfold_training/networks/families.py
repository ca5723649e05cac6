"""The families of networks there are. A new one is a folder of files and a row here."""

from __future__ import annotations

from .family import Family, Network
from .kpcn.network import Kpcn
from .kpcn.sizes import KpcnSizes
from .pathfold.network import Pathfold
from .pathfold.sizes import PathfoldSizes
from .sizes import Sizes

FAMILIES = {
    "kpcn": Family(KpcnSizes, Kpcn),
    "pathfold": Family(PathfoldSizes, Pathfold),
}


def family(network: object) -> str:
    """Of a preset's block `network`; 'kpcn' where it does not say."""
    return network.get("family", "kpcn") if isinstance(network, dict) else getattr(network, "family", "kpcn")


def build(sizes: Sizes) -> Network:
    """The network with its first weights, drawn by torch's own generator."""
    return FAMILIES[sizes.family].network(sizes)
