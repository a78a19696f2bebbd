"""Meshes from Gmsh: .msh files and the model in memory, names and second-order nodes kept.

Geometry is built in :mod:`solver.mesh.gmsh_model`. Gmsh is imported only when it is used.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import skfem

from solver.mesh.checks import facets
from solver.mesh.structured import curved

# Gmsh's numbers of the volume elements that there is an element for.
TETRAHEDRA, HEXAHEDRA = {4: 1, 11: 2}, {5: 1, 17: 2, 12: 2}

# What the first line of a .msh file begins with.
HEADS = (b"$MeshFormat", b"$Comments")


def load_gmsh():
    """The gmsh module; raises ImportError, saying what to install, where it can't be loaded."""
    try:
        import gmsh
    except (ImportError, OSError) as error:
        raise ImportError(
            f"Gmsh can't be loaded ({error}); install it with pip install 'foldlab[gmsh]', and on "
            "a Linux machine without a desktop also its X libraries (Debian: libglu1-mesa "
            "libgl1 libxrender1 libxcursor1 libxft2 libxinerama1)"
        ) from error
    return gmsh


@contextmanager
def session(name: str):
    """A Gmsh model of its own, silent and on one thread, as a context that gives the module."""
    gmsh = load_gmsh()
    owner = not gmsh.isInitialized()
    if owner:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.NumThreads", 1)
    gmsh.model.add(name)
    try:
        yield gmsh
    finally:
        if owner:
            gmsh.finalize()
        else:
            gmsh.model.remove()


def refused(call, *given):
    """The call's result; what Gmsh raises becomes a ValueError."""
    try:
        return call(*given)
    except Exception as error:  # Gmsh has no finer type
        raise ValueError(f"Gmsh refused: {error}") from error


def read(path: str | Path) -> skfem.Mesh:
    """Mesh of a .msh file; see :func:`from_model`. Raises ValueError where it can't be read."""
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"there is no file {path}")
    with path.open("rb") as file:
        head = file.read(20)
    # Gmsh would run anything else as a script of its own, which may call the system.
    if path.suffix.lower() != ".msh" or not head.startswith(HEADS):
        raise ValueError(f"{path} is no mesh of Gmsh; write it as .msh, format 2.2 or 4.1")
    with session("read") as gmsh:
        refused(gmsh.merge, str(path))
        return from_model()


def from_model() -> skfem.Mesh:
    """Mesh of Gmsh's current model, of first or second order, physical groups as names.

    Volumes' groups become sub-domains, surfaces' groups boundaries (those between two volumes
    too). A group without a name is called by its number. Raises ValueError unless the volumes are
    all of tetrahedra (4 or 10 nodes) or all of hexahedra (8, 20 or 27), and for a named surface
    that is no face of a cell.
    """
    mesh = load_gmsh().model.mesh
    groups = load_gmsh().model.getPhysicalGroups
    kinds = [int(k) for k in mesh.getElementTypes(3)]
    if len(kinds) != 1 or kinds[0] not in TETRAHEDRA | HEXAHEDRA:
        names = ", ".join(mesh.getElementProperties(k)[0] for k in kinds) or "none"
        raise ValueError(
            f"volume elements in the Gmsh model: {names}; expected one kind: tetrahedra with 4 or "
            "10 nodes, or hexahedra with 8, 20 or 27"
        )
    kind = kinds[0]
    _, _, order, n, local, _ = mesh.getElementProperties(kind)
    local = np.reshape(local, (n, 3))
    if kind in HEXAHEDRA:
        local = (local + 1) / 2
    first = skfem.MeshTet1 if kind in TETRAHEDRA else skfem.MeshHex1
    tags, X, _ = mesh.getNodes()
    place = np.empty(int(tags.max()) + 1, int)
    place[tags] = np.arange(len(tags))
    X = np.reshape(X, (-1, 3))
    cells, of_volume, count = [], {}, 0
    for _, volume in load_gmsh().model.getEntities(3):
        part = place[mesh.getElementsByType(kind, volume)[1]].reshape(-1, n)
        of_volume[volume] = np.arange(count, count + len(part))
        cells.append(part)
        count += len(part)
    cells = np.concatenate(cells)  # (m, n) rows of X
    # Format 2.2 has a cell once for each group that its volume is in.
    _, once, same = np.unique(np.sort(cells), axis=0, return_index=True, return_inverse=True)
    order_of = np.argsort(np.argsort(once))[same.ravel()]
    cells = cells[np.sort(once)]
    of_volume = {volume: np.unique(order_of[ids]) for volume, ids in of_volume.items()}
    # Corners in scikit-fem's order, found by their reference positions.
    at = [_nearest(local, p) for p in first.elem.refdom.p.T]
    t = cells[:, at].T
    used, flat = np.unique(t, return_inverse=True)
    t = flat.reshape(t.shape)
    out = first(np.ascontiguousarray(X[used].T), np.ascontiguousarray(t.astype(np.int32)))
    names = [
        (
            dim,
            load_gmsh().model.getPhysicalName(dim, tag) or str(tag),
            load_gmsh().model.getEntitiesForPhysicalGroup(dim, tag),
        )
        for dim, tag in groups()
    ]
    sub = {name: np.concatenate([of_volume[v] for v in ent]) for d, name, ent in names if d == 3}
    named = {name: _faces(mesh, ent, place) for d, name, ent in names if d == 2}
    # Corner numbers of faces; −1 for nodes that are no cell's corner.
    number = np.full(len(X), -1)
    number[used] = np.arange(len(used))
    named = _match(out, {name: number[faces] for name, faces in named.items() if len(faces)})
    if order == 2:
        out = curved(out, _second_order(local, X, cells))
    return out.with_subdomains(sub).with_boundaries(named)


def _nearest(local: np.ndarray, p: np.ndarray) -> int:
    gap = np.linalg.norm(local - p, axis=1)
    best = int(np.argmin(gap))
    return best if gap[best] < 1e-9 else -1


def _second_order(local: np.ndarray, X: np.ndarray, cells: np.ndarray):
    """Positions of quadratic nodes for :func:`curved`."""
    serendipity = skfem.ElementHexS2()

    def positions(at: np.ndarray) -> np.ndarray:
        a = _nearest(local, at)
        if a >= 0:
            return X[cells[:, a]]
        # Face and centre nodes, which 20-node hexahedra don't have.
        nodes = [_nearest(local, p) for p in serendipity.doflocs]
        weights = [serendipity.lbasis(at[:, None], b)[0].item() for b in range(20)]
        return np.einsum("b,mbi->mi", weights, X[cells[:, nodes]])

    return positions


def _faces(mesh, entities, place) -> np.ndarray:
    """Corners of the surface elements on entities, (f, 3 or 4), as rows of the node table."""
    out = []
    for surface in entities:
        for kind in mesh.getElementTypes(2, surface):
            corners, n = mesh.getElementProperties(kind)[5], mesh.getElementProperties(kind)[3]
            nodes = mesh.getElementsByType(kind, surface)[1].reshape(-1, n)
            out.append(place[nodes[:, :corners]])
    return np.concatenate(out) if out else np.zeros((0, 3), int)


def _match(mesh: skfem.Mesh, named: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Facet numbers of faces given by their corners."""
    mine = np.sort(facets(mesh).vertices, axis=0)
    facets_of = {}
    for name, faces in named.items():
        theirs = np.sort(faces.T, axis=0)
        if len(theirs) != len(mine):
            raise ValueError(f"boundary {name!r} has faces of another shape than the cells'")
        both, back = np.unique(np.hstack([mine, theirs]), axis=1, return_inverse=True)
        of = np.full(both.shape[1], -1)
        of[back.ravel()[: mine.shape[1]]] = np.arange(mine.shape[1])
        facets_of[name] = np.unique(of[back.ravel()[mine.shape[1] :]])
        if facets_of[name][0] < 0:
            raise ValueError(f"boundary {name!r} has faces that belong to no cell; mend the model")
    return facets_of
