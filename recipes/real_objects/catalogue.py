"""The table of real objects: where each comes from and how its part is cut out.

Conventions
-----------
* Paths are relative to the data folder (``../shared/data`` next to a checkout).
* ``up`` is the file axis that points up in that file.
* Cuts are given in the object frame of the complete object: z up, centred on its box, largest side
  1. ``toward_deg`` is the azimuth of the side taken away; ``from_deg`` are azimuths of scanner
  views. Numbers are fixed, so that every benchmark sees the same parts.
* Meshes that are one geometry in several colours, and the two ducks, appear once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gscomplete.splats import Splats
from gscomplete.views import UpAxis
from splatcomplete_data.cuts.geometry import PartialCut, by_visibility, eyes_at
from splatcomplete_data.cuts.named import SCAN_DISTANCE, BoxCut, PlaneCut

Source = Literal["mesh", "scan", "splats"]


@dataclass(frozen=True, slots=True)
class ScanCut:
    """Keep what a scanner sees from some viewpoints.

    With the depth image of ``by_visibility``, which all recorded figures were made with; that of
    ``cuts.named.ScanCut`` is as fine as the splats are.
    """

    from_deg: tuple[float, ...]
    """Azimuths of the viewpoints."""
    elevation_deg: float = 20.0
    """Their elevation."""

    def apply(self, complete: Splats) -> PartialCut:
        """Return what is kept of splats in the object frame."""
        angles = np.deg2rad(self.from_deg), np.deg2rad(self.elevation_deg)
        return by_visibility(complete, eyes_at(*angles, SCAN_DISTANCE))


Cut = PlaneCut | BoxCut | ScanCut


@dataclass(frozen=True, slots=True)
class Entry:
    """One object of the table."""

    name: str
    """Short name, unique."""
    path: str
    """File, relative to the data folder."""
    source: Source
    """What kind of file it is."""
    up: UpAxis
    """File axis that points up; scans are levelled on their table first and then point Z up."""
    cut: Cut | None
    """How the part is cut out; None where the file itself is partial."""
    prompt: str | None = None
    """Prompt; None = the caption in the data folder's manifest."""
    texture: str | None = None
    """Picture for a mesh whose file lost it, relative to the data folder."""
    is_shaded: bool = True
    """Whether soft light is multiplied into a mesh's colours, which have none of their own."""
    has_linear_colors: bool = True
    """False for glTF files whose exporter wrote sRGB numbers as factors."""
    label: int | None = None
    """Object number of a labelled scan (labels are ten times that, and more)."""


def _mesh(name: str, path: str, up: UpAxis, cut: Cut, **options: object) -> Entry:
    """Describe a mesh below the data folder's ``mesh``."""
    return Entry(name, f"mesh/{path}", "mesh", up, cut, **options)  # type: ignore[arg-type]


def _house(name: str, folder: str, cut: Cut, **options: object) -> Entry:
    """Describe a model of the ``aws_house`` collection."""
    path = f"aws_house/{folder}/meshes/aws_{folder}_visual.DAE"
    return _mesh(name, path, "Z", cut, **options)


def _scan(name: str, file: str, label: int, prompt: str) -> Entry:
    """Describe one labelled object of a Kinect table-top scene."""
    path = f"lidar/pcl/mOSD/{file}.pcd"
    return Entry(name, path, "scan", "Z", None, prompt=prompt, label=label)


ENTRIES: tuple[Entry, ...] = (
    _mesh("blue_mug", "urdf_models/blue_cup/textured.obj", "Z", PlaneCut(60.0, -0.03)),
    _mesh("bowl", "urdf_models/doraemon_bowl/textured.obj", "Z", PlaneCut(200.0)),
    _mesh("apple", "urdf_models/plastic_apple/textured.obj", "Z", PlaneCut(120.0, -0.05)),
    _mesh("stapler", "urdf_models/stapler_1/textured.obj", "Z", ScanCut((30.0,))),
    _mesh("plate_rack", "urdf_models/plate_holder/textured.obj", "Z", PlaneCut(0.0, -0.01)),
    _house("orange_table", "BalconyTable_01", PlaneCut(150.0)),
    _house("armchair", "ChairA_01", ScanCut((20.0, 60.0))),
    _house("bed", "Bed_01", PlaneCut(0.0)),
    _house("coffee_table", "CoffeeTable_01", PlaneCut(90.0)),
    _house("refrigerator", "Refrigerator_01", PlaneCut(180.0)),
    _house("camera", "SecurityCamera_01", PlaneCut(90.0)),
    _house("lantern", "LightC_01", PlaneCut(45.0)),
    _house("sofa", "Sofa_01", ScanCut((30.0,))),
    _house("shoe_rack", "ShoeRack_01", BoxCut((-0.5, -0.5, -0.5), (0.0, 0.5, 0.5))),
    _house("chandelier", "Chandelier_01", PlaneCut(30.0)),
    _mesh("banana", "bullet3/data/banana.obj", "Z", PlaneCut(0.0, -0.05)),
    _mesh("pink_cup", "bullet3/data/dinnerware/cup/Cup/textured-0008192.obj", "Z", PlaneCut(250.0)),
    _mesh("soccer_ball", "bullet3/pybullet_data/soccerball.obj", "Z", PlaneCut(140.0)),
    _mesh("duck", "trimesh/Duck.glb", "Y", PlaneCut(90.0)),
    _mesh("knight", "gltf_transform/chr_knight.glb", "Y", PlaneCut(90.0, -0.02)),
    _mesh("chair", "habitat/chair.glb", "Y", PlaneCut(0.0)),
    _mesh("donut", "habitat/donut.glb", "Y", PlaneCut(300.0)),
    _mesh(
        "frying_pan",
        "libero/stable_scanned_objects/chefmate_8_frypan/chefmate_8_frypan.obj",
        "Z",
        PlaneCut(90.0),
    ),
    _mesh(
        "ramekin",
        "libero/stable_scanned_objects/glazed_rim_porcelain_ramekin/"
        "glazed_rim_porcelain_ramekin.obj",
        "Z",
        PlaneCut(10.0),
    ),
    _mesh("cat_statue", "playcanvas/cat.glb", "Y", ScanCut((-60.0, -110.0))),
    _mesh("tree", "playcanvas/low-poly-tree.glb", "Y", PlaneCut(120.0)),
    _mesh("statue", "playcanvas/statue.glb", "Y", ScanCut((-90.0,))),
    _mesh("cow", "pytorch3d/cow_mesh/cow.obj", "Y", PlaneCut(0.0)),
    _mesh("milk_truck", "trimesh/CesiumMilkTruck.glb", "Y", PlaneCut(90.0)),
    _mesh("bottle", "trimesh/fuze.obj", "Z", PlaneCut(60.0)),
    _mesh("sunflower", "webxr/sunflower/sunflower.gltf", "Y", PlaneCut(180.0)),
    _mesh("headset", "webxr/headset/headset.gltf", "Y", PlaneCut(0.0), has_linear_colors=False),
    _mesh(
        "speaker", "webxr/stereo/stereo.gltf", "Y", PlaneCut(90.0, -0.02), has_linear_colors=False
    ),
    _mesh(
        "beige_mug",
        "libero/libero_mug_yellow/libero_mug_yellow.obj",
        "Y",
        PlaneCut(30.0),
        prompt="a beige mug with yellow letters",
        texture="mesh/libero/libero_mug_yellow/libero_mug_yellow.png",
    ),
    _mesh("armadillo", "armadillo.obj", "Y", PlaneCut(90.0)),
    Entry("biker", "splats/playcanvas/biker.compressed.ply", "splats", "-Y", PlaneCut(90.0, -0.01)),
    _scan("scan_cereal_box", "test_test10", 2, "a yellow cereal box"),
    _scan("scan_red_box", "learn_learn12", 3, "a red and white box"),
    _scan("scan_yellow_box", "test_test47", 5, "a yellow box"),
    _scan("scan_blue_box", "test_test60", 4, "a light blue box"),
    _scan("scan_book", "test_test60", 9, "a green book"),
    _scan("scan_cake_tin", "learn_learn33", 2, "a round brown cake tin"),
    _scan("scan_yellow_bowl", "learn_learn40", 4, "a pale yellow bowl upside down"),
    _scan("scan_white_bowl", "learn_learn33", 4, "a white bowl"),
    _scan("scan_mug", "learn_learn33", 5, "a white mug"),
    _scan("scan_cup", "learn_learn33", 6, "a white cup"),
    _scan("scan_can", "learn_learn40", 3, "a white can with red spots"),
    _scan("scan_red_can", "test_test37", 2, "a red tin can lying on its side"),
)
