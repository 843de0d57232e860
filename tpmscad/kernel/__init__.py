"""Conversion of boundary representations to OCCT shapes and STEP files: the only room that imports OCP.

Other rooms import its names from here. A name is loaded when it is first used, so that a lattice does not wait for the import of
the Boolean operations or of the renderer.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tpmscad._lazy_import import lazy_attributes

if TYPE_CHECKING:
    from tpmscad.errors import NotQuadric
    from tpmscad.kernel.body_import.body_brep import brep_and_source_faces, brep_from_shape
    from tpmscad.kernel.boolean.body_split import SplitSolid, split_body
    from tpmscad.kernel.boolean.boolean_operations import (
        KernelSolids,
        betti_numbers,
        estimate_volume,
        intersect_solids,
        subtract_solid,
    )
    from tpmscad.kernel.boolean.erosion import erode
    from tpmscad.kernel.boolean.hollow_body import (
        count_closed_cavities,
        find_skin_faces,
        resolve_open_faces,
        subtract_voids,
    )
    from tpmscad.kernel.boolean.inward_offset import offset_by_occt
    from tpmscad.kernel.boolean.local_intersection import intersect_locally
    from tpmscad.kernel.build.revolved_body import revolve_profile
    from tpmscad.kernel.build.solids import BuiltSolids, build_regions, build_solids, select_solids
    from tpmscad.kernel.export.brep_file import write_brep_file
    from tpmscad.kernel.export.gltf_file import write_glb
    from tpmscad.kernel.export.layer_files import LAYER_WRITERS
    from tpmscad.kernel.export.mesh_parts import group_faces
    from tpmscad.kernel.export.shape_file import write_shape, write_solids
    from tpmscad.kernel.export.shared_faces import number_distinct_faces, write_plain_brep
    from tpmscad.kernel.export.solid_mesh import mesh_solids
    from tpmscad.kernel.export.stl_file import write_stl
    from tpmscad.kernel.export.threemf_file import write_3mf
    from tpmscad.kernel.measure.cad_body import CadBody, read_body
    from tpmscad.kernel.measure.edge_gaps import measure_accuracy
    from tpmscad.kernel.measure.face_charts import FaceChart
    from tpmscad.kernel.measure.file_check import check_excerpt
    from tpmscad.kernel.measure.foreign_files import (
        ForeignShape,
        check_foreign_step,
        read_foreign_coloured_solids,
        read_foreign_step,
    )
    from tpmscad.kernel.measure.mass_properties import face_moments
    from tpmscad.kernel.measure.shape_extents import shape_bounds
    from tpmscad.kernel.measure.shape_report import ShapeReport, StepReport, check_shape, check_step, is_valid
    from tpmscad.kernel.measure.shape_sampling import (
        Creases,
        FaceSamples,
        find_creases,
        have_touching_solids,
        lie_on_surface,
        sample_faces,
        sample_solid,
    )
    from tpmscad.kernel.measure.signed_distance import body_field
    from tpmscad.kernel.measure.skin_depth import SkinDepth, SkinThickness, measure_skin_thickness, sample_depths
    from tpmscad.kernel.measure.validity import is_brep_valid
    from tpmscad.kernel.occt.bounding_boxes import bounding_box, enclosing_box
    from tpmscad.kernel.occt.construction import copy_placement, make_compound
    from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE, transform_shape
    from tpmscad.kernel.occt.exploration import faces_of, require_shape, solids_of, vertices_of
    from tpmscad.kernel.occt.shape_bundles import pack_results, unpack_results
    from tpmscad.kernel.printability.cavities import Cavity, find_cavities
    from tpmscad.kernel.printability.opposite_sides import (
        SampledSurface,
        Width,
        find_least_solid_gap,
        find_least_width,
    )
    from tpmscad.kernel.printability.overhang import Overhang, measure_overhang
    from tpmscad.kernel.render.palette import SURFACE_COLOUR, diverging_scale, piece_colour, sequential_scale
    from tpmscad.kernel.render.picture import draw_scene, render_png, write_picture
    from tpmscad.kernel.render.polar_surface import draw_polar_surface
    from tpmscad.kernel.render.scene import Scene, pieces_of
    from tpmscad.kernel.slicing.contours import LayerContours, slice_solids, triangulate_for_slices
    from tpmscad.kernel.step.brep_writer import write_step
    from tpmscad.kernel.step.cell_assembly import arrange_cells
    from tpmscad.kernel.step.face_labels import (
        NamedSolid,
        find_label_colour,
        label_faces,
        label_outer_faces,
        label_shape_faces,
        order_labels,
    )
    from tpmscad.kernel.step.product_entities import Colour
    from tpmscad.kernel.step.shape_writer import name_solids
    from tpmscad.kernel.step.step_reader import StepContent, read_step
    from tpmscad.kernel.step.text_check import check_text

__all__ = [
    "CONFUSION_TOLERANCE",
    "LAYER_WRITERS",
    "SURFACE_COLOUR",
    "BuiltSolids",
    "CadBody",
    "Cavity",
    "Colour",
    "Creases",
    "FaceChart",
    "FaceSamples",
    "ForeignShape",
    "KernelSolids",
    "LayerContours",
    "NamedSolid",
    "NotQuadric",
    "Overhang",
    "SampledSurface",
    "Scene",
    "ShapeReport",
    "SkinDepth",
    "SkinThickness",
    "SplitSolid",
    "StepContent",
    "StepReport",
    "Width",
    "arrange_cells",
    "betti_numbers",
    "body_field",
    "bounding_box",
    "brep_and_source_faces",
    "brep_from_shape",
    "build_regions",
    "build_solids",
    "check_excerpt",
    "check_foreign_step",
    "check_shape",
    "check_step",
    "check_text",
    "copy_placement",
    "count_closed_cavities",
    "diverging_scale",
    "draw_polar_surface",
    "draw_scene",
    "enclosing_box",
    "erode",
    "estimate_volume",
    "face_moments",
    "faces_of",
    "find_cavities",
    "find_creases",
    "find_label_colour",
    "find_least_solid_gap",
    "find_least_width",
    "find_skin_faces",
    "group_faces",
    "have_touching_solids",
    "intersect_locally",
    "intersect_solids",
    "is_brep_valid",
    "is_valid",
    "label_faces",
    "label_outer_faces",
    "label_shape_faces",
    "lie_on_surface",
    "make_compound",
    "measure_accuracy",
    "measure_overhang",
    "measure_skin_thickness",
    "mesh_solids",
    "name_solids",
    "number_distinct_faces",
    "offset_by_occt",
    "order_labels",
    "pack_results",
    "piece_colour",
    "pieces_of",
    "read_body",
    "read_foreign_coloured_solids",
    "read_foreign_step",
    "read_step",
    "render_png",
    "require_shape",
    "resolve_open_faces",
    "revolve_profile",
    "sample_depths",
    "sample_faces",
    "sample_solid",
    "select_solids",
    "sequential_scale",
    "shape_bounds",
    "slice_solids",
    "solids_of",
    "split_body",
    "subtract_solid",
    "subtract_voids",
    "transform_shape",
    "triangulate_for_slices",
    "unpack_results",
    "vertices_of",
    "write_3mf",
    "write_brep_file",
    "write_glb",
    "write_picture",
    "write_plain_brep",
    "write_shape",
    "write_solids",
    "write_step",
    "write_stl",
]

_MODULE_OF_NAME = {
    "SURFACE_COLOUR": "tpmscad.kernel.render.palette",
    "CONFUSION_TOLERANCE": "tpmscad.kernel.occt.convert",
    "LAYER_WRITERS": "tpmscad.kernel.export.layer_files",
    "BuiltSolids": "tpmscad.kernel.build.solids",
    "CadBody": "tpmscad.kernel.measure.cad_body",
    "Colour": "tpmscad.kernel.step.product_entities",
    "Creases": "tpmscad.kernel.measure.shape_sampling",
    "FaceSamples": "tpmscad.kernel.measure.shape_sampling",
    "KernelSolids": "tpmscad.kernel.boolean.boolean_operations",
    "NamedSolid": "tpmscad.kernel.step.face_labels",
    "NotQuadric": "tpmscad.errors",
    "Scene": "tpmscad.kernel.render.scene",
    "ShapeReport": "tpmscad.kernel.measure.shape_report",
    "SplitSolid": "tpmscad.kernel.boolean.body_split",
    "StepContent": "tpmscad.kernel.step.step_reader",
    "StepReport": "tpmscad.kernel.measure.shape_report",
    "arrange_cells": "tpmscad.kernel.step.cell_assembly",
    "betti_numbers": "tpmscad.kernel.boolean.boolean_operations",
    "FaceChart": "tpmscad.kernel.measure.face_charts",
    "body_field": "tpmscad.kernel.measure.signed_distance",
    "bounding_box": "tpmscad.kernel.occt.bounding_boxes",
    "brep_and_source_faces": "tpmscad.kernel.body_import.body_brep",
    "brep_from_shape": "tpmscad.kernel.body_import.body_brep",
    "build_regions": "tpmscad.kernel.build.solids",
    "build_solids": "tpmscad.kernel.build.solids",
    "check_excerpt": "tpmscad.kernel.measure.file_check",
    "check_shape": "tpmscad.kernel.measure.shape_report",
    "check_step": "tpmscad.kernel.measure.shape_report",
    "check_text": "tpmscad.kernel.step.text_check",
    "count_closed_cavities": "tpmscad.kernel.boolean.hollow_body",
    "diverging_scale": "tpmscad.kernel.render.palette",
    "draw_polar_surface": "tpmscad.kernel.render.polar_surface",
    "draw_scene": "tpmscad.kernel.render.picture",
    "enclosing_box": "tpmscad.kernel.occt.bounding_boxes",
    "estimate_volume": "tpmscad.kernel.boolean.boolean_operations",
    "face_moments": "tpmscad.kernel.measure.mass_properties",
    "faces_of": "tpmscad.kernel.occt.exploration",
    "vertices_of": "tpmscad.kernel.occt.exploration",
    "solids_of": "tpmscad.kernel.occt.exploration",
    "require_shape": "tpmscad.kernel.occt.exploration",
    "find_creases": "tpmscad.kernel.measure.shape_sampling",
    "pack_results": "tpmscad.kernel.occt.shape_bundles",
    "unpack_results": "tpmscad.kernel.occt.shape_bundles",
    "copy_placement": "tpmscad.kernel.occt.construction",
    "find_label_colour": "tpmscad.kernel.step.face_labels",
    "group_faces": "tpmscad.kernel.export.mesh_parts",
    "have_touching_solids": "tpmscad.kernel.measure.shape_sampling",
    "intersect_locally": "tpmscad.kernel.boolean.local_intersection",
    "intersect_solids": "tpmscad.kernel.boolean.boolean_operations",
    "is_brep_valid": "tpmscad.kernel.measure.validity",
    "is_valid": "tpmscad.kernel.measure.shape_report",
    "label_faces": "tpmscad.kernel.step.face_labels",
    "label_shape_faces": "tpmscad.kernel.step.face_labels",
    "lie_on_surface": "tpmscad.kernel.measure.shape_sampling",
    "make_compound": "tpmscad.kernel.occt.construction",
    "mesh_solids": "tpmscad.kernel.export.solid_mesh",
    "offset_by_occt": "tpmscad.kernel.boolean.inward_offset",
    "measure_accuracy": "tpmscad.kernel.measure.edge_gaps",
    "measure_skin_thickness": "tpmscad.kernel.measure.skin_depth",
    "sample_depths": "tpmscad.kernel.measure.skin_depth",
    "SkinDepth": "tpmscad.kernel.measure.skin_depth",
    "SkinThickness": "tpmscad.kernel.measure.skin_depth",
    "erode": "tpmscad.kernel.boolean.erosion",
    "find_skin_faces": "tpmscad.kernel.boolean.hollow_body",
    "name_solids": "tpmscad.kernel.step.shape_writer",
    "order_labels": "tpmscad.kernel.step.face_labels",
    "piece_colour": "tpmscad.kernel.render.palette",
    "pieces_of": "tpmscad.kernel.render.scene",
    "read_body": "tpmscad.kernel.measure.cad_body",
    "read_foreign_coloured_solids": "tpmscad.kernel.measure.foreign_files",
    "read_foreign_step": "tpmscad.kernel.measure.foreign_files",
    "check_foreign_step": "tpmscad.kernel.measure.foreign_files",
    "ForeignShape": "tpmscad.kernel.measure.foreign_files",
    "read_step": "tpmscad.kernel.step.step_reader",
    "render_png": "tpmscad.kernel.render.picture",
    "resolve_open_faces": "tpmscad.kernel.boolean.hollow_body",
    "revolve_profile": "tpmscad.kernel.build.revolved_body",
    "sample_faces": "tpmscad.kernel.measure.shape_sampling",
    "sample_solid": "tpmscad.kernel.measure.shape_sampling",
    "select_solids": "tpmscad.kernel.build.solids",
    "sequential_scale": "tpmscad.kernel.render.palette",
    "shape_bounds": "tpmscad.kernel.measure.shape_extents",
    "label_outer_faces": "tpmscad.kernel.step.face_labels",
    "number_distinct_faces": "tpmscad.kernel.export.shared_faces",
    "write_plain_brep": "tpmscad.kernel.export.shared_faces",
    "slice_solids": "tpmscad.kernel.slicing.contours",
    "triangulate_for_slices": "tpmscad.kernel.slicing.contours",
    "LayerContours": "tpmscad.kernel.slicing.contours",
    "split_body": "tpmscad.kernel.boolean.body_split",
    "subtract_solid": "tpmscad.kernel.boolean.boolean_operations",
    "subtract_voids": "tpmscad.kernel.boolean.hollow_body",
    "transform_shape": "tpmscad.kernel.occt.convert",
    "write_3mf": "tpmscad.kernel.export.threemf_file",
    "write_brep_file": "tpmscad.kernel.export.brep_file",
    "write_glb": "tpmscad.kernel.export.gltf_file",
    "write_picture": "tpmscad.kernel.render.picture",
    "write_shape": "tpmscad.kernel.export.shape_file",
    "write_solids": "tpmscad.kernel.export.shape_file",
    "write_step": "tpmscad.kernel.step.brep_writer",
    "write_stl": "tpmscad.kernel.export.stl_file",
    "Cavity": "tpmscad.kernel.printability.cavities",
    "find_cavities": "tpmscad.kernel.printability.cavities",
    "SampledSurface": "tpmscad.kernel.printability.opposite_sides",
    "Width": "tpmscad.kernel.printability.opposite_sides",
    "find_least_solid_gap": "tpmscad.kernel.printability.opposite_sides",
    "find_least_width": "tpmscad.kernel.printability.opposite_sides",
    "Overhang": "tpmscad.kernel.printability.overhang",
    "measure_overhang": "tpmscad.kernel.printability.overhang",
}

__getattr__, __dir__ = lazy_attributes(__name__, _MODULE_OF_NAME)
