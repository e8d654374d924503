"""Which shapes touch, and how near: what overlaps at rest may overlap by as much, and apparel keeps off the limbs that
it is near to.

A contact of MuJoCo with a margin below zero begins only at that depth, which is right for spheres, capsules and boxes,
but not for meshes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bunraku.physics.settings import PhysicsSettings

__all__ = ["fit_contacts"]

NEAR = 1e-3  # shapes that are this near at rest may come as near, and no nearer [m]
KEPT = 0.02  # of the distance between apparel and a limb at rest, this much is kept [m]
SLACK = 4e-3  # but for this [m]
DEEP = 0.8  # a body that is deeper in a limb at rest, as a share of its radius, is not kept out of it


def fit_contacts(spec: Any, model: Any, settings: PhysicsSettings, step: float) -> None:
    """Add the contacts that are not the rule to a world.

    Args:
        spec: The world's `MjSpec`; shapes named "limb ..." are limbs of the body, and "rod ..." those of apparel that
            collide with them.
        model: What it compiles to, at rest.
        settings: Says which limbs are near.
        step: Time step [s].
    """
    import mujoco

    data = mujoco.MjData(model)
    how = {"solref": [max(0.02, 2.5 * step), 1.0]}
    margins = model.geom_margin.copy()
    model.geom_margin[:] = NEAR
    mujoco.mj_forward(model, data)
    deepest: dict[tuple[str, str], float] = {}
    for contact in data.contact[: data.ncon]:
        first, second = sorted(model.geom(int(geom)).name for geom in contact.geom)
        deepest[first, second] = min(deepest.get((first, second), np.inf), float(contact.dist))
    model.geom_margin[:] = margins
    for (first, second), depth in sorted(deepest.items()):
        rough = max(spec.geom(name).condim for name in (first, second))
        friction = max(spec.geom(name).friction[0] for name in (first, second))
        spec.add_pair(
            geomname1=first,
            geomname2=second,
            margin=depth - NEAR,
            condim=rough,
            friction=[friction, friction, 0, 0, 0],
            **how,
        )
    for first, second, distance in _near_limbs(model, data, settings.nearby):
        spec.add_pair(
            geomname1=first, geomname2=second, margin=min(distance, KEPT) - SLACK, condim=1, friction=[0.0] * 5, **how
        )


def _near_limbs(model: Any, data: Any, near: float) -> list[tuple[str, str, float]]:
    """Rods and limbs that are near each other, and how far apart; a rod that is deep in a limb would be pushed to any
    side.
    """
    import mujoco

    names = [model.geom(geom).name for geom in range(model.ngeom)]
    limbs = np.array([geom for geom, name in enumerate(names) if name.startswith("limb")], np.int64)
    out = []
    for rod in (geom for geom, name in enumerate(names) if name.startswith("rod")):
        apart = (
            np.linalg.norm(data.geom_xpos[limbs] - data.geom_xpos[rod], axis=1)
            - model.geom_rbound[limbs]
            - model.geom_rbound[rod]
        )
        for limb in limbs[apart < near]:
            distance = float(mujoco.mj_geomDistance(model, data, rod, int(limb), near, None))
            if -DEEP * model.geom_size[limb, 0] < distance < near:
                out.append((names[rod], names[limb], distance))
    return out
