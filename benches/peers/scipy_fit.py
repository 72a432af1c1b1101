"""Seconds that scipy.optimize.least_squares takes for eight starts on the 108 radiances of a series.

scipy_fit.py SERIES_DIR: one JSON object with the best of five runs and where each start ended. The
model is what a user would write in NumPy: exact visibility of the sawtooth's facets, one Beckmann
lobe, a Lambert term; seven free parameters, default tolerances, method "lm", difference quotients.
"""

import csv
import json
import sys
import time
import tomllib

import numpy as np
from scipy.optimize import least_squares

ETA = 1.54
STARTS = [(ridge, alpha) for ridge in (5, 10, 15, 20) for alpha in (0.06, 0.15)]


def directions(tilt, turn, lamp):
    """Towards lamp and camera in the sample's frame (u, v, n), lamp in the tilt plane."""
    c, s = np.cos(turn), np.sin(turn)

    def seen(angle):
        x, z = np.sin(angle), np.cos(angle)
        return x * s, x * c, z

    return seen(tilt + lamp), seen(tilt)


def radiance(p, tilt, turn, lamp):
    ridge, log_u, log_v, gain, albedo, turned, tilted = p
    i, o = directions(tilt + tilted, turn + turned, lamp)
    s, c = np.sin(ridge), np.cos(ridge)

    def facet(w):
        return w[1] * c - w[2] * s, w[1] * s + w[2] * c

    (ie, im), (oe, om) = facet(i), facet(o)
    hu, he, hm = i[0] + o[0], ie + oe, im + om
    length2 = hu**2 + he**2 + hm**2
    x, y = hu / hm, he / hm
    au, av = np.exp(log_u), np.exp(log_v)
    lobe = np.exp(-((x / au) ** 2) - (y / av) ** 2) / (np.pi * au * av * (hm * hm / length2) ** 2)
    tan = np.tan(ridge)
    visible = np.minimum(
        np.clip(1 - tan * np.maximum(ie / im, 0), 0, 1), np.clip(1 - tan * np.maximum(oe / om, 0), 0, 1)
    )
    cos = 0.5 * np.sqrt(length2)
    t = np.sqrt(1 - (1 - cos * cos) / ETA**2)
    fresnel = (((cos - ETA * t) / (cos + ETA * t)) ** 2 + ((ETA * cos - t) / (ETA * cos + t)) ** 2) / 2
    return gain * c * visible * lobe * fresnel / (4 * o[2]) + albedo / np.pi * i[2]


def main(folder):
    with open(folder + "/radiance.csv") as file:
        rows = [row for row in csv.DictReader(file) if row["region"] == "all"]
    with open(folder + "/manifest.toml", "rb") as file:
        lamp = np.radians(tomllib.load(file)["rig"]["theta_l_deg"])
    tilt = np.radians([float(row["theta_c_deg"]) for row in rows])
    turn = np.radians([float(row["phi_s_deg"]) for row in rows])
    seen = np.array([float(row["radiance"]) for row in rows])
    sigma = 0.01 * seen + 0.001

    def residuals(p):
        return (radiance(p, tilt, turn, lamp) - seen) / sigma

    best, ends = np.inf, []
    for _ in range(5):
        began = time.perf_counter()
        ends = []
        for ridge, alpha in STARTS:
            first = [np.radians(ridge), np.log(alpha), np.log(alpha), 1, 0.1, 0, 0]
            ends.append(least_squares(residuals, first, x_scale="jac", method="lm"))
        best = min(best, time.perf_counter() - began)
    least = min(end.cost for end in ends)
    elsewhere = sum(end.success and end.cost > least * (1 + 1e-6) for end in ends)
    answer = min(ends, key=lambda end: end.cost)
    print(
        json.dumps(
            {
                "seconds": best,
                "observations": len(rows),
                "cost": 2 * least,
                "theta_r_deg": float(np.degrees(abs(answer.x[0]))),
                "success_elsewhere": int(elsewhere),
            }
        )
    )


if __name__ == "__main__":
    main(sys.argv[1])
