"""A block of gyroid whose walls thicken with height, fitted by the workers of a Dask cluster.

Any concurrent.futures.Executor does: here that of a Dask client, on this machine unless an address is given. The workers import
tpmscad, so it must be installed where they run. Curves and patches are fitted and measured in pieces of fixed size, wherever: the
solid is the same, face by face, as without a cluster. What is sent is the field and plain arrays; poles and measures come back.

    pip install dask distributed
    python examples/solidify_dask.py [tcp://scheduler:8786]
"""

from __future__ import annotations

import sys
from pathlib import Path

from tpmscad import fields
from tpmscad.solids._solidify import solidify


def main(
    path: str | Path = "block.step", address: str | None = None, cells: int = 1, tol: float = 0.02
) -> dict[str, object]:
    """Write the solid and return what its certificate says; SystemExit with a hint where Dask is not installed."""
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise SystemExit("this example needs Dask: pip install dask distributed") from None
    size = 10.0 * cells
    level = fields.ramp("z", (0.0, size), (0.2, 0.5))
    field = fields.sheet(fields.tpms("gyroid", period=10.0), -level, level)
    cluster = address or LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
    with Client(cluster) as client:
        model = solidify(field, ((0, 0, 0), (size, size, size)), tol=tol, executor=client.get_executor())
    if not isinstance(cluster, str):
        cluster.close()
    model.export_step(path)
    return model.certificate.to_dict()


if __name__ == "__main__":
    print(main(address=sys.argv[1] if len(sys.argv) > 1 else None))
