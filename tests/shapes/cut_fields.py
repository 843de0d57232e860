"""Fields of which layouts are made in a box: three lattices, and a ball whole and cut by the box."""

from __future__ import annotations

import numpy as np

from tpmscad import fields

LO, HI = np.array([0.0, 0.0, 0.0]), np.array([10.0, 11.0, 9.0])
FIELDS = {
    "gyroid": fields.rod(fields.tpms("gyroid", 10.0), -0.3),
    "schwarz_p": fields.rod(fields.tpms("schwarz_p", 10.0, phase=(0.1, 0.0, 0.0)), 0.2),
    "iwp": fields.pore(fields.tpms("iwp", 11.0), 0.3),
    "ball": fields.sphere((5.1, 5.3, 4.2), 3.0),
    "ball cut by the box": fields.sphere((1.1, 9.3, 4.2), 3.0),
}
