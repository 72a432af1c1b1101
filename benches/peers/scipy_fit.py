"""Seconds that scipy.optimize.least_squares takes for eight starts on the 108 radiances of a series.

scipy_fit.py SERIES_DIR: one JSON object with the CPU seconds of the best of five runs and where each start ended, for the
same model written twice: as a user would (vectors, any complex index), and by hand for speed
(components, a real index). Exact visibility of the sawtooth's facets, one Beckmann lobe, a Lambert
term; seven free parameters, default tolerances, method "lm", difference quotients.
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


def plain(p, tilt, turn, lamp):
    """As a user would: unit vectors as rows, frames by dot products, Fresnel for any complex index."""
    ridge, log_u, log_v, gain, albedo, turned, tilted = p
    tilt, turn = tilt + tilted, turn + turned
    zero, one = np.zeros_like(tilt), np.ones_like(tilt)
    n = np.stack([zero, zero, one], axis=-1)
    v = np.stack([np.cos(turn), np.sin(turn), zero], axis=-1)
    u = np.cross(v, n)

    def in_sample(angle):
        w = np.stack([np.sin(angle), zero, np.cos(angle)], axis=-1)
        return np.stack([np.sum(w * axis, axis=-1) for axis in (u, v, n)], axis=-1)

    i, o = in_sample(tilt + lamp), in_sample(tilt)
    h = i + o
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    facet = np.array([0, np.sin(ridge), np.cos(ridge)])
    along = np.array([0, np.cos(ridge), -np.sin(ridge)])
    h_m, au, av = h @ facet, np.exp(log_u), np.exp(log_v)
    x, y = h[:, 0] / h_m, (h @ along) / h_m
    lobe = np.exp(-((x / au) ** 2) - (y / av) ** 2) / (np.pi * au * av * h_m**4)

    def open_to(w):
        hidden = np.tan(ridge) * (w @ along) / (w @ facet)
        return np.clip(1 - np.maximum(hidden, 0), 0, 1)

    cos = np.sum(i * h, axis=-1)
    eta = ETA + 0j
    inside = np.sqrt(1 - (1 - cos**2) / eta**2)
    r_s = (cos - eta * inside) / (cos + eta * inside)
    r_p = (eta * cos - inside) / (eta * cos + inside)
    fresnel = (np.abs(r_s) ** 2 + np.abs(r_p) ** 2) / 2
    visible = np.cos(ridge) * np.minimum(open_to(i), open_to(o))
    return gain * visible * lobe * fresnel / (4 * o[:, 2]) + albedo / np.pi * i[:, 2]


def by_hand(p, tilt, turn, lamp):
    """The same by components, with what repeats taken out."""
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

    answers = {}
    for model in (plain, by_hand):

        def residuals(p):
            return (model(p, tilt, turn, lamp) - seen) / sigma

        best, ends = np.inf, []
        for _ in range(5):
            began = time.process_time()
            ends = []
            for ridge, alpha in STARTS:
                first = [np.radians(ridge), np.log(alpha), np.log(alpha), 1, 0.1, 0, 0]
                ends.append(least_squares(residuals, first, x_scale="jac", method="lm"))
            best = min(best, time.process_time() - began)
        least = min(end.cost for end in ends)
        answer = min(ends, key=lambda end: end.cost)
        answers[model.__name__] = {
            "seconds": best,
            "observations": len(rows),
            "cost": 2 * least,
            "theta_r_deg": float(np.degrees(abs(answer.x[0]))),
            "success_elsewhere": int(sum(end.success and end.cost > least * (1 + 1e-6) for end in ends)),
        }
    print(json.dumps(answers))


if __name__ == "__main__":
    main(sys.argv[1])
