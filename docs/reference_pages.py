"""Pages of the reference that are made from the code: functions by job, one page for each module, results, front ends."""

from __future__ import annotations

import inspect
import zlib
from importlib import import_module
from types import ModuleType
from typing import Any

MODULES = {
    "tpmscad": "Solids and files",
    "tpmscad.fields": "Fields",
    "tpmscad.maps": "Maps",
    "tpmscad.sweeps": "Sweeps",
    "tpmscad.blending": "Blends",
    "tpmscad.surfaces": "Surfaces",
    "tpmscad.topology": "Topology",
}
"""Modules with public names, and the titles of their pages."""

RESULTS = (
    "tpmscad.Model",
    "tpmscad.Certificate",
    "tpmscad.results.domain_results.FluidDomains",
    "tpmscad.results.domain_results.FaceContact",
    "tpmscad.results.triangulated_infill.TriangulatedInfill",
    "tpmscad.studies.layer_slices.Slices",
    "tpmscad.kernel.export.layer_files.Layer",
    "tpmscad.meshing.volume_mesh.VolumeMesh",
    "tpmscad.simulation.properties.HomogenizedProperties",
    "tpmscad.studies._permeability.ChannelPermeability",
    "tpmscad.LatticeDesign",
    "tpmscad.studies.flow_results.FlowEstimate",
    "tpmscad.studies.flow_results.ExchangerEstimate",
    "tpmscad.Metrics",
    "tpmscad.PrintReport",
    "tpmscad.kernel.body_import.cad_body.BodyFile",
    "tpmscad.kernel.measure.shape_report.StepReport",
    "tpmscad.files.beam_report.BeamReport",
    "tpmscad.files.mesh_report.MeshReport",
    "tpmscad.files.file_formats.ExportedFile",
    "tpmscad.files._export_infill.InfillFile",
    "tpmscad.files._export_instances.InstancedFile",
    "tpmscad.files._export_slabs.SlabFiles",
    "tpmscad.sweeps.SweepResults",
    "tpmscad.blending.BlendResult",
)
"""What the public functions return, and what that holds."""

JOBS: dict[str, tuple[str, ...]] = {
    "Make a solid": ("lattice", "struts", "solidify", "blend"),
    "Fill a body": (
        "infill",
        "fluid_domains",
        "infill_layers",
        "infill_triangles",
        "export_infill",
        "read_body",
        "body_field",
    ),
    "Structures as fields": tuple(
        f"fields.{name}"
        for name in (
            *(
                "tpms",
                "sheet",
                "rod",
                "pore",
                "wall",
                "strut_lattice",
                "plate_lattice",
                "core",
                "beams",
                "wireframe",
                "struts",
                "bspline_unit",
                "expression",
            ),
            *(
                "from_function",
                "as_field",
                "constant",
                "normal_distance",
                "volume_fraction",
                "threshold_for",
                "find_surface",
            ),
        )
    ),
    "Regions as fields": tuple(f"fields.{name}" for name in ("box", "sphere", "cylinder", "halfspace", "image_region")),
    "Images, scans and points as fields": tuple(
        f"fields.{name}" for name in ("sampled", "labels", "label_partition", "mesh", "scattered")
    ),
    "Combine and move fields": tuple(
        f"fields.{name}"
        for name in (
            *("union", "intersection", "difference", "complement", "smooth_union", "smooth_intersection"),
            *("smooth_difference", "translate", "rotate", "scale", "warp"),
        )
    ),
    "Grade": tuple(
        f"fields.{name}" for name in ("ramp", "clip", "linear", "coordinate", "graded_threshold", "cell_sizes")
    ),
    "Wrap and stretch": tuple(
        f"maps.{name}"
        for name in ("cylinder", "sphere", "between", "trivariate", "grading", "stretching", "composition", "as_map")
    ),
    "Files": (
        "export_step",
        "export_beams",
        "export_infill",
        "export_instances",
        "export_slabs",
        "check_step",
        "Model.export",
    ),
    "Meshes": ("Model.mesh", "Model.hexahedra", "infill_triangles"),
    "Simulate": ("homogenize", "design_for", "permeability", "estimate_flow", "estimate_exchanger"),
    "Measure and check before printing": (
        "measure",
        "check_print",
        "Model.check_print",
        "Model.slices",
        "infill_layers",
    ),
    "Look": ("render", "render_step", "Model.render"),
    "Many designs": ("sweep",),
}
"""Public functions, and methods of the result, by what they are for."""

FRONT_ENDS = {
    "tpmscad.build123d": ("Tpms", "TpmsInfill", "Struts"),
    "cq_plugins.tpms": ("tpms", "tpmsInfill", "struts", "tpmsModels"),
}

CONSTANTS = ("None", "True", "False")
ABSTRACT = ("Callable", "Iterable", "Iterator", "Mapping", "Sequence")

LINKED: dict[str, tuple[str, dict[str, str]]] = {
    "numpy": (
        "https://numpy.org/doc/stable/",
        {
            "numpy.ndarray": "reference/generated/numpy.ndarray.html",
            "numpy.typing.ArrayLike": "reference/typing.html",
        },
    ),
    "python": (
        "https://docs.python.org/3/",
        {
            "pathlib.Path": "library/pathlib.html",
            "concurrent.futures.Executor": "library/concurrent.futures.html",
            "float": "library/functions.html",
            "int": "library/functions.html",
            "bool": "library/functions.html",
            "str": "library/stdtypes.html",
            "tuple": "library/stdtypes.html",
            "dict": "library/stdtypes.html",
            **dict.fromkeys(CONSTANTS, "library/constants.html"),
            **{f"collections.abc.{name}": "library/collections.abc.html" for name in ABSTRACT},
        },
    ),
    "build123d": (
        "https://build123d.readthedocs.io/en/latest/",
        {"topology.Solid": "direct_api_reference.html", "topology.Compound": "direct_api_reference.html"},
    ),
}
"""Pages of other projects that types link to, by name: an inventory of a few entries each, so that the build needs no network."""

ALIASES = {
    **{name.rpartition(".")[2]: name for name in RESULTS},
    "Field": "tpmscad.fields.Field",
    "Map": "tpmscad.maps.Map",
    **{name.lower(): f"collections.abc.{name}" for name in ABSTRACT},
    "ndarray": "numpy.ndarray",
    "array_like": "numpy.typing.ArrayLike",
    "Path": "pathlib.Path",
    "Executor": "concurrent.futures.Executor",
    **{name: f":class:`python:{name}`" for name in ("float", "int", "bool", "str", "tuple", "dict")},
    "Solid": "topology.Solid",
    "Compound": "topology.Compound",
}
"""Words of the sections of parameters and results that are types."""


def make_reference() -> dict[str, bytes]:
    """The pages by name, and the inventories of other projects."""
    described: set[int] = set()
    pages = {
        "functions.rst": describe_jobs(),
        "api_results.rst": describe_results(described),
        "api_front_ends.rst": describe_front_ends(),
    }
    for module, title in MODULES.items():
        pages[f"api_{module.replace('.', '_')}.rst"] = describe_module(module, title, described)
    inventories = {f"{project}.inv": format_inventory(project, linked) for project, (_, linked) in LINKED.items()}
    return {name: text.encode() for name, text in pages.items()} | inventories


def find_public(name: str) -> Any:
    """The value of a dotted name."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            value = import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            value = getattr(value, part)
        return value
    raise LookupError(name)


def describe_jobs() -> str:
    """The public functions by what they are for, with a line each."""
    title = "Functions by job"
    lines = [title, "=" * len(title), ""]
    for job, names in JOBS.items():
        lines += [job, "-" * len(job), "", ".. list-table::", "   :widths: 30 70", "   :class: names", ""]
        for name in names:
            summary = (inspect.getdoc(find_public(f"tpmscad.{name}")) or "").split("\n\n")[0].replace("\n", " ")
            kind = "meth" if name.startswith("Model.") else "func"
            lines += [f"   * - :py:{kind}:`{name} <tpmscad.{name}>`", f"     - {summary.replace('`', '``')}"]
        lines.append("")
    return "\n".join(lines)


def describe_module(module: str, title: str, described: set[int]) -> str:
    """A page of reStructuredText with the public names of a module that no other page describes yet."""
    home = import_module(module)
    lines = [title, "=" * len(title), "", f".. currentmodule:: {module}", ""]
    for name in home.__all__:
        value = getattr(home, name)
        if id(value) in described:
            continue
        described.add(id(value))
        if inspect.isclass(value):
            lines += [f".. autoclass:: {name}", "   :members:", ""]
        elif inspect.isfunction(value):
            lines += [f".. autofunction:: {name}", ""]
    return "\n".join(lines)


def describe_results(described: set[int]) -> str:
    """A page of the classes that the public functions return."""
    title = "Results"
    lines = [title, "=" * len(title), "", "What the functions return, with its values and methods.", ""]
    for name in RESULTS:
        described.add(id(find_public(name)))
        lines += [f".. autoclass:: {name}", "   :members:", ""]
    return "\n".join(lines)


def describe_front_ends() -> str:
    """A page of the parts of build123d and the methods of CadQuery's Workplane."""
    title = "build123d and CadQuery"
    lines = [title, "=" * len(title), "", ".. currentmodule:: tpmscad.build123d", ""]
    for name in FRONT_ENDS["tpmscad.build123d"]:
        lines += [f".. autoclass:: {name}", "   :members: export, render", ""]
    lines += [
        "Methods of Workplane",
        "-" * 20,
        "",
        "``import cq_plugins.tpms`` adds them to ``cadquery.Workplane``.",
        "",
    ]
    lines += [".. currentmodule:: cq_plugins.tpms", ""]
    for name in FRONT_ENDS["cq_plugins.tpms"]:
        lines += [f".. autofunction:: {name}", ""]
    return "\n".join(lines)


def stand_in_for_cadquery() -> ModuleType:
    """An empty CadQuery, whose kernel is another one than build123d's, for the methods that are added to it."""
    module = ModuleType("cadquery")
    for name in ("Workplane", "Solid", "Shape", "Compound"):
        setattr(module, name, type(name, (), {"__module__": "cadquery"}))
    return module


def format_inventory(project: str, pages: dict[str, str]) -> bytes:
    """The bytes of an inventory of Sphinx (objects.inv, version 2) of classes and constants."""
    head = (
        f"# Sphinx inventory version 2\n# Project: {project}\n# Version: \n"
        "# The remainder of this file is compressed using zlib.\n"
    )
    lines = "".join(
        f"{name} py:{'data' if name in CONSTANTS else 'class'} 1 {page}#{name} -\n" for name, page in pages.items()
    )
    return head.encode() + zlib.compress(lines.encode(), 9)
