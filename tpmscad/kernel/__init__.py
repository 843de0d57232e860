"""Conversion of boundary representations to OCCT shapes and files, and back: the only room that imports OCP."""

from tpmscad.errors import MissingKernel
from tpmscad.kernel_wheels import describe_load_failure, find_installed_versions

try:
    # A name of it: of a wheel that was removed, empty folders may be left, which Python takes for a package.
    from OCP.gp import gp_Pnt as _  # noqa: F401
except ImportError as error:
    raise MissingKernel(describe_load_failure(str(error), find_installed_versions())) from error
