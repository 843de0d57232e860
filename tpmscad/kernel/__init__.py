"""Conversion of boundary representations to OCCT shapes and files, and back: the only room that imports OCP."""

from tpmscad.kernel_wheels import explained_load_failure

with explained_load_failure("the CAD kernel"):
    # A name of it: of a wheel that was removed, empty folders may be left, which Python takes for a package.
    from OCP.gp import gp_Pnt as _  # noqa: F401
