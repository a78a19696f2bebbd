"""Small files of every kind that foldlab reads, as they should be; made once for all cases."""

from __future__ import annotations

import shutil
from contextlib import chdir
from importlib import resources
from pathlib import Path

import numpy as np
import pandas as pd
import skfem
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

from foldlab.campaign.campaign import run_campaign
from foldlab.design import FULL, REDUCED
from foldlab.labels.store import LabelStore
from foldlab.labels.timoshenko import TimoshenkoSource
from foldlab.learning.saving import save_model
from foldlab.learning.train import train_on
from foldlab.learning.tune import Search, tune
from foldlab.tables import write_table
from foldlab.tracking import track
from solver.mesh.body import Body
from solver.output import grid

SEARCH = Search(2, validation=0.25, epochs=(4, 8), width=(2, 4), depth=(1, 1), members=(1, 1))
MODELS = {"m": ("tree", {}), "n": ("network", {"members": 1, "epochs": 20, "hidden": [3]})}
# Each corner of a cube, as Gmsh's formats have it.
MSH = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
1
3 1 "body"
$EndPhysicalNames
$Nodes
12
{nodes}
$EndNodes
$Elements
2
1 5 2 1 1 1 2 4 3 5 6 8 7
2 5 2 1 1 5 6 8 7 9 10 12 11
$EndElements
"""


def make(folder: Path) -> Path:
    """The folder with all of them; what is there already is kept."""
    if folder.is_dir():
        return folder
    fresh = folder.with_name(f"{folder.name}.new")
    shutil.rmtree(fresh, ignore_errors=True)
    fresh.mkdir(parents=True)
    source = TimoshenkoSource()
    designs = REDUCED.sample(120, seed=3)
    labels = source.evaluate(designs)
    for name, table in (("d", designs.head(12)), ("l", labels)):
        write_table(table, fresh / f"{name}.csv")
        write_table(table, fresh / f"{name}.parquet")
    write_table(FULL.sample(5, seed=3), fresh / "f.csv")
    with LabelStore(fresh / "s.db") as store:
        run_campaign(designs.head(12), source, store, progress=False)
    for name, (model, options) in MODELS.items():
        fitted, result = train_on(labels, model, seed=0, holdout=0.3, options=options)
        save_model(fitted, fresh / name, result)
    tune(labels, REDUCED, fresh / "study.journal", SEARCH)
    with (resources.files("foldlab") / "data" / "materials.csv").open(encoding="utf-8") as file:
        (fresh / "materials.csv").write_text(file.read(), encoding="utf-8")
    (fresh / "c.toml").write_text("epochs = 12\n")
    with chdir(fresh), track("wrong", {}):
        pass
    _fields(fresh)
    fresh.rename(folder)
    return folder


def _fields(folder: Path) -> None:
    X = np.array([(x, y, z) for z in (0, 1, 2) for y in (0, 1) for x in (0, 1)], float)
    nodes = "\n".join(f"{k + 1} {x:g} {y:g} {z:g}" for k, (x, y, z) in enumerate(X))
    (folder / "unit.msh").write_text(MSH.format(nodes=nodes))
    body = Body.build(skfem.MeshHex().refined(1), "hex8")
    beta = np.linspace(0, 1, len(body.nodes))
    table = pd.DataFrame(body.nodes, columns=["x", "y", "z"]).assign(beta=beta)
    table.to_csv(folder / "b.csv", index=False)
    whole = grid(body, point_data={"beta": beta})
    for mode in ("Ascii", "Binary", "Appended"):
        path = folder / f"{mode.lower()}.vtu"
        writer = vtkXMLUnstructuredGridWriter(file_name=str(path), input_data=whole)
        getattr(writer, f"SetDataModeTo{mode}")()
        writer.Write()
